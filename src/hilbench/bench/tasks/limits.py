"""Limits of a run: each quantity's warning and trip level, checked in every cycle, in nearly every one compiled."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.compiled import COUNT, TABLE, Reals, Wholes, Wholes2, arrays_in, entry_point, load, record_type
from hilbench.cycle_program import CompiledStage, never
from hilbench.errors import BenchFaultError
from hilbench.topology.safety import Limit
from hilbench.topology.sample import CycleSample, PerSample
from hilbench.twin.virtual_io import SYNCHRONIZED

#: A warning is over, and can come again, when the quantity has fallen below this share of its level.
_RELEASE = 0.95
_NO_LIMIT = Limit()


class LimitTripError(BenchFaultError):
    """A quantity went beyond its trip level."""


#: What a compiled look at a sample finds.
BELOW_LIMITS, LIMIT_REACHED = 0, 1


class LimitMonitor(ABC):
    """Checks each sample for events to report."""

    look: PerSample[CompiledStage]  #: compiled check of a sample: BELOW_LIMITS if there is nothing to report

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Events of a sample: texts, each after its kind. May raise a fault."""
        look = self.look(sample)
        return [] if look.function(look.argument, look.table) == BELOW_LIMITS else self.found(sample)

    @abstractmethod
    def found(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Events of a sample that is known not to be below its limits."""


@dataclass(frozen=True, slots=True)
class Limited:
    """A quantity that a signal shows, or its size, unless `signed`: what messages call it, its unit, and its levels."""

    name: str
    signal: str
    unit: str
    limit: Limit
    signed: bool = False


#: A cycle, s; the least difference of positions and ratio of estimates that are reported; 1 if there has been a sample
#: since the drives were enabled; 1 if a warning is on.
_FIGURES = record_type("cycle_s", "apart", "ratio", "started", "warned")
#: Travel of a cycle, m, from which on an axis itself shows how long a cycle was: one that the bench has missed counts;
#: and most cycles that do.
_SHOWS_M, _MOST_CYCLES = 1e-4, 100.0


class _Arrays(NamedTuple):
    """A sample; places in it of sizes, with their report thresholds, of estimates, with the model's values, and of
    positions and set points of the axes; for each axis with the one after it the difference of their positions at the
    start, what their set points have added up to since, the last position of the latter, and how far they are off: in
    this sample and the one before, as a single late one is, and in this sample alone."""

    values: Reals
    words: Wholes
    sizes_at: Wholes
    thresholds: Reals
    estimates_at: Wholes
    models: Reals
    positions_at: Wholes
    commands_at: Wholes
    at_start: Reals
    commanded: Reals
    last: Reals
    off: Reals
    off_now: Reals
    figures: Annotated[Any, _FIGURES]


#: look(place of the twin's status, table of `_Arrays`): BELOW_LIMITS where every quantity is below its threshold, and
#: no warning is on, as in nearly every cycle.
@entry_point(COUNT, TABLE)
def _look(status: int, table: Wholes2) -> int:
    a = arrays_in(table, _Arrays)
    values, figures = a.values, a.figures
    loud = 0 if figures.warned == 0.0 else 1
    for k in range(len(a.off)):
        position, command, duration_s = values[a.positions_at[k + 1]], values[a.commands_at[k + 1]], figures.cycle_s
        apart = values[a.positions_at[k]] - position
        if figures.started == 0.0:
            a.at_start[k], a.last[k] = apart, position
        if abs(command) * duration_s > _SHOWS_M:
            duration_s = min(max((position - a.last[k]) / command, 0.0), _MOST_CYCLES * duration_s)
        a.commanded[k] += (values[a.commands_at[k]] - command) * duration_s
        a.last[k] = position
        off, before = abs(apart - a.at_start[k] - a.commanded[k]), a.off_now[k]
        a.off[k], a.off_now[k] = before if off > before else off, off
        loud += not a.off[k] < figures.apart
    figures.started = 1.0
    for k in range(len(a.thresholds)):
        loud += not -a.thresholds[k] < values[a.sizes_at[k]] < a.thresholds[k]
    if a.words[status] & SYNCHRONIZED != 0:
        for k in range(len(a.models)):
            ratio = values[a.estimates_at[k]] / a.models[k]
            loud += not (ratio > 0.0 and max(ratio, 1.0 / ratio) < figures.ratio)
    return BELOW_LIMITS if loud == 0 else LIMIT_REACHED


class LimitWatch(LimitMonitor):
    """Check of what is `limited` in the samples of a run; of what is `estimated`, against the model's values by signal
    (`models`), by `ratio`; of the position differences of a line's axes, by these names, against `difference_m`."""

    def __init__(
        self,
        limited: Sequence[Limited],
        estimated: str,
        models: Mapping[str, float],
        ratio: Limit,
        differences: Sequence[str] = (),
        difference_m: Limit = _NO_LIMIT,
        cycle_s: float = 0.0,
    ) -> None:
        self._warned: set[str] = set()  # quantities whose warning is on
        self._limited, self._estimated, self._models, self._ratio = limited, estimated, models, ratio
        self._differences, self._difference_m = differences, difference_m
        axes = range(1, len(differences) + 2) if differences else ()
        positions, commands = [f"x{axis}_m" for axis in axes], [f"v{axis}_cmd_m_s" for axis in axes]
        self._signals = [each.signal for each in limited], list(models), positions, commands
        self._since_start = np.zeros((5, len(differences)))
        figures = cycle_s, _lowest_threshold(difference_m), _lowest_threshold(ratio), 0.0, 0.0
        self._figures = np.array([figures], _FIGURES)
        self.look = PerSample(self._on)
        load(_look)

    def _on(self, sample: CycleSample) -> CompiledStage:
        sizes, estimates, positions, commands = map(type(sample).places, self._signals)
        thresholds = np.array([_lowest_threshold(each.limit) for each in self._limited])
        arrays = _Arrays(
            *(sample.reals, sample.wholes, sizes, thresholds, estimates, np.array([*self._models.values()])),
            *(positions, commands, *self._since_start, self._figures),
        )
        return CompiledStage(_look, type(sample).place("twin_status"), arrays, continues=BELOW_LIMITS, fallback=never)

    def found(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity.

        Raises LimitTripError; no number counts as beyond the trip level.
        """
        warnings = []
        for name, value, unit, limit in self._quantities(sample):
            if limit.trip is not None and not value <= limit.trip:
                raise LimitTripError(
                    f"t = {sample.t_s:.3f} s: {name} is {value:.4g}{unit}, beyond its trip level {limit.trip:g}{unit}"
                )
            if limit.warning is None or value < _RELEASE * limit.warning:
                self._warned.discard(name)
            elif value > limit.warning and name not in self._warned:
                self._warned.add(name)
                text = f"{name} is {value:.4g}{unit}, beyond its warning level {limit.warning:g}{unit}"
                warnings.append((name, text))
        self._figures["warned"] = bool(self._warned)
        return warnings

    def _quantities(self, sample: CycleSample) -> Iterator[tuple[str, float, str, Limit]]:
        """What is watched: its name, its value (a size), its unit with a space before it, and its levels."""
        for each in self._limited:
            value = getattr(sample, each.signal)
            yield each.name, value if each.signed else abs(value), f" {each.unit}", each.limit
        for name, difference_m in zip(self._differences, self._since_start[3].tolist(), strict=True):
            yield name, difference_m, " m", self._difference_m
        if is_synchronized(sample):
            for signal, value in self._models.items():
                ratio = getattr(sample, signal) / value
                yield self._estimated, max(ratio, 1.0 / ratio) if ratio > 0.0 else inf, "", self._ratio


def _lowest_threshold(limit: Limit) -> float:
    """The least size of a quantity at which `LimitWatch.found` has anything to do, while no warning is on."""
    levels = (limit.trip, None if limit.warning is None else _RELEASE * limit.warning)
    return min((level for level in levels if level is not None), default=inf)


def is_synchronized(sample: CycleSample) -> bool:
    """True if the twin reports that it is synchronized."""
    return bool(sample.twin_status & SYNCHRONIZED)


def load_motor_labels(motors: Sequence[str]) -> dict[str, str]:
    """Names of the load motors in messages, by name."""
    return {name: "the load motor" if len(motors) == 1 else f"load motor {name}" for name in motors}
