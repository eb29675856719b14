"""Saturation watch: drives at their torque limit, where a run shows the limit and not the control or the web.

The drive reports it (statusword 6041h bit 11, internal limit active), or its torque shows it (6077h at the limit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.tasks.limits import BELOW_LIMITS, LIMIT_REACHED, LimitMonitor, load_motor_labels
from hilbench.cia402.state_machine import STATUS_INTERNAL_LIMIT
from hilbench.compiled import COUNT, TABLE, Reals, Wholes, Wholes2, arrays_in, entry_point, load, record_type, records
from hilbench.cycle_program import CompiledStage, never
from hilbench.plant.parameters import per_item
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role
from hilbench.topology.sample import CycleSample, PerSample

#: Share of the limit from which a measured torque is at it.
_AT_LIMIT = 0.98
#: How long a drive has to be off its limit for that to count as over.
_QUIET_S = 0.5


@dataclass
class _Limited:
    """A drive that has reached its limit: since when, when last, and how long altogether."""

    since_s: float
    last_s: float
    total_s: float = 0.0


#: Places of a drive's signals in a sample.
_DRIVE_AT = record_type("torque", "statusword", of=np.int64)


class _Arrays(NamedTuple):
    """A sample, and of each drive (D,) places in it and the torque from which it is at its limit; `limited` (1,): how
    many were so in the last cycle."""

    values: Reals
    words: Wholes
    at: Annotated[Any, records(_DRIVE_AT)]
    at_limit_Nm: Reals
    limited: Wholes


#: look(0, table of `_Arrays`): BELOW_LIMITS where no drive is at its limit, as in nearly every cycle.
@entry_point(COUNT, TABLE)
def _look(_: int, table: Wholes2) -> int:
    a = arrays_in(table, _Arrays)
    limited = a.limited[0]
    for k in range(len(a.at)):
        at = a.at[k]
        limited += abs(a.values[at.torque]) >= a.at_limit_Nm[k] or a.words[at.statusword] & _LIMITED != 0
    return BELOW_LIMITS if limited == 0 else LIMIT_REACHED


_LIMITED = int(STATUS_INTERNAL_LIMIT)


class SaturationWatch(LimitMonitor):
    """Watches the samples of one run."""

    def __init__(self, config: BenchConfig) -> None:
        drives = config.drive_parameters
        self._cycle_s = config.cycle_time_s
        axes, motors = config.parts_of(Role.AXIS), config.load_motors
        self._limits_Nm = {f"axis {part.axis}": per_item(drives.torque_limit_Nm, part.axis or 1) for part in axes}
        labels = load_motor_labels(list(motors))
        self._limits_Nm |= {labels[name]: motor.motor.torque_limit_Nm for name, motor in motors.items()}
        self._signals = [(f"axis {k}", f"tau{k}_Nm", f"statusword{k}") for k in range(1, len(axes) + 1)]
        self._signals += [(label, f"tau_{name}_Nm", f"statusword_{name}") for name, label in labels.items()]
        self._limited: dict[str, _Limited] = {}
        self._at_limit_Nm = np.array([_AT_LIMIT * self._limits_Nm[drive] for drive, _, _ in self._signals])
        self._known, self.look = np.zeros(1, np.int64), PerSample(self._on)
        load(_look)

    def _on(self, sample: CycleSample) -> CompiledStage:
        names = [name for _, torque, status in self._signals for name in (torque, status)]
        at = type(sample).places(names).view(_DRIVE_AT)
        arrays = _Arrays(sample.reals, sample.wholes, at, self._at_limit_Nm, self._known)
        return CompiledStage(_look, 0, arrays, continues=BELOW_LIMITS, fallback=never)

    def found(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Begin or end of saturation in this cycle, as text for the operator, with the kind of notice."""
        found = []
        for drive, torque, status in self._signals:
            torque_Nm, statusword = getattr(sample, torque), getattr(sample, status)
            limit_Nm, known = self._limits_Nm[drive], self._limited.get(drive)
            by_torque = abs(torque_Nm) >= _AT_LIMIT * limit_Nm
            if by_torque or statusword & STATUS_INTERNAL_LIMIT:
                if known is None:
                    known = self._limited[drive] = _Limited(sample.t_s, sample.t_s)
                    shown = f"torque {torque_Nm:.3g} N·m" if by_torque else "statusword bit 11"
                    shown += f", torque limit {limit_Nm:g} N·m"
                    found.append(
                        (f"{drive} reached", f"{drive} is at its limit ({shown}): it can't follow its set-point")
                    )
                known.last_s = sample.t_s
                known.total_s += self._cycle_s
            elif known is not None and sample.t_s - known.last_s > _QUIET_S:
                del self._limited[drive]
                lasted_s = known.last_s - known.since_s + self._cycle_s
                text = f"{drive} has left its limit: at it for {known.total_s:.3g} s within {lasted_s:.3g} s"
                found.append((f"{drive} left", text))
        self._known[0] = len(self._limited)
        return found
