"""Drives at their torque limit: what a run shows then is the limit, not the control or the web.

The drive reports it (statusword 6041h bit 11, internal limit active), or its torque shows it (6077h at the limit).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.limits import load_motor_labels
from hilbench.cia402.state_machine import STATUS_INTERNAL_LIMIT
from hilbench.compiled import INDICES, VECTOR, entry_point, number_of_sources
from hilbench.plant.parameters import per_item
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role
from hilbench.topology.sample import CycleSample, PlacesIn

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


Vector = NDArray[np.float64]
Places = NDArray[np.int64]


def _entry_point(sources: int) -> Callable[[Vector, Places, Places, Vector], bool]:
    """For Python; `sources` as in `compiled.number_of_sources`."""

    @entry_point(VECTOR, INDICES, INDICES, VECTOR)
    def is_quiet(values: Vector, words: Places, at: Places, at_limit_Nm: Vector) -> bool:
        """Whether no drive is at its limit, as in nearly every cycle; `at` (2 D,): where of each torque and statusword
        are, in `values` and `words`."""
        limited = 0 if sources >= 0 else 1
        for k in range(len(at_limit_Nm)):
            limited += abs(values[at[2 * k]]) >= at_limit_Nm[k] or words[at[2 * k + 1]] & _LIMITED != 0
        return limited == 0

    return is_quiet


_LIMITED = int(STATUS_INTERNAL_LIMIT)
_is_quiet = _entry_point(number_of_sources(__file__))


class SaturationWatch:
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
        self._at = PlacesIn([name for _, torque, status in self._signals for name in (torque, status)])
        self._at_limit_Nm = np.array([_AT_LIMIT * self._limits_Nm[drive] for drive, _, _ in self._signals])
        # Compiled, or loaded, before anybody waits for a cycle.
        _is_quiet(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """What begins or ends in this cycle, as text for the operator, with the kind of notice that it is."""
        if not self._limited and self._is_quiet(sample):
            return []
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
        return found

    def _is_quiet(self, sample: CycleSample) -> bool:
        return _is_quiet(sample.reals, sample.wholes, self._at.of(sample), self._at_limit_Nm)
