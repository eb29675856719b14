"""Limits of a run: each quantity's warning and trip level, checked in every cycle."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import table_of
from hilbench.cycle_program import CompiledStage, Function
from hilbench.errors import BenchFaultError
from hilbench.topology.safety import Limit
from hilbench.topology.sample import CycleSample
from hilbench.twin.virtual_io import SYNCHRONIZED

#: A warning is over, and can come again, when the quantity has fallen below this share of its level.
_RELEASE = 0.95


class LimitTripError(BenchFaultError):
    """A quantity went beyond its trip level."""


#: What is watched in a cycle: its name, its value (a size), its unit with a space before it, and its levels.
DiagnosisAnswer = tuple[str, float, str, Limit]


#: What a compiled look at a sample finds.
BELOW_LIMITS, LIMIT_REACHED = 0, 1


@dataclass(frozen=True)
class LimitReading:
    """Compiled check of a sample: BELOW_LIMITS if there is nothing to report."""

    function: Function
    argument: int
    arrays: Sequence[Any]
    _table: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_table", table_of(self.arrays))

    @property
    def is_below_limits(self) -> bool:
        """True if the check finds nothing now."""
        return self.function(self.argument, self._table) == BELOW_LIMITS

    def stage(self, fallback: Callable[[int], bool]) -> CompiledStage:
        """Compiled stage of a cycle that makes the check."""
        return CompiledStage(
            self.function, self.argument, self.arrays, continues=BELOW_LIMITS, fallback=fallback, table=self._table
        )


class LimitMonitor(Protocol):
    """Checks each sample for events to report."""

    def look(self, sample: CycleSample) -> LimitReading:
        """Compiled check of this sample, which is mostly the same object."""

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Events of a sample: texts, each after its kind. May raise a fault."""

    def found(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Events of a sample that is known not to be below its limits."""


@dataclass(frozen=True, slots=True)
class Limited:
    """A quantity whose size a signal shows: what messages call it, its unit, and its levels."""

    name: str
    signal: str
    unit: str
    limit: Limit


class Levels:
    """Warnings that are on in a run."""

    def __init__(self) -> None:
        self._warned: set[str] = set()

    @property
    def quiet(self) -> bool:
        """True if no warning is on."""
        return not self._warned

    def check(self, t_s: float, quantities: Iterable[DiagnosisAnswer]) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity.

        Raises LimitTripError; no number counts as beyond the trip level.
        """
        warnings = []
        for name, value, unit, limit in quantities:
            if limit.trip is not None and not value <= limit.trip:
                raise LimitTripError(
                    f"t = {t_s:.3f} s: {name} is {value:.4g}{unit}, beyond its trip level {limit.trip:g}{unit}"
                )
            if limit.warning is None or value < _RELEASE * limit.warning:
                self._warned.discard(name)
            elif value > limit.warning and name not in self._warned:
                self._warned.add(name)
                text = f"{name} is {value:.4g}{unit}, beyond its warning level {limit.warning:g}{unit}"
                warnings.append((name, text))
        return warnings


def lowest_threshold(limit: Limit) -> float:
    """The least size of a quantity at which `Levels.check` has anything to do, while no warning is on."""
    levels = (limit.trip, None if limit.warning is None else _RELEASE * limit.warning)
    return min((level for level in levels if level is not None), default=inf)


def apart(estimate: float, model: float) -> float:
    """Ratio of an estimate to the model's value, or its inverse (>= 1); inf for an estimate not above 0."""
    ratio = estimate / model
    return max(ratio, 1.0 / ratio) if ratio > 0.0 else inf


def is_synchronized(sample: CycleSample) -> bool:
    """True if the twin reports that it is synchronized."""
    return bool(sample.twin_status & SYNCHRONIZED)


def load_motor_labels(motors: Sequence[str]) -> dict[str, str]:
    """Names of the load motors in messages, by name."""
    return {name: "the load motor" if len(motors) == 1 else f"load motor {name}" for name in motors}
