"""Limits of a run: each quantity's warning and trip level, checked in every cycle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf

from hilbench.cycle_program import CompiledStage
from hilbench.errors import BenchFaultError
from hilbench.topology.safety import Limit
from hilbench.topology.sample import CycleSample, PerSample
from hilbench.twin.virtual_io import SYNCHRONIZED

#: A warning is over, and can come again, when the quantity has fallen below this share of its level.
_RELEASE = 0.95


class LimitTripError(BenchFaultError):
    """A quantity went beyond its trip level."""


#: What is watched in a cycle: its name, its value (a size), its unit with a space before it, and its levels.
LimitedValue = tuple[str, float, str, Limit]


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


class Levels:
    """Warnings that are on in a run."""

    def __init__(self) -> None:
        self._warned: set[str] = set()

    @property
    def quiet(self) -> bool:
        """True if no warning is on."""
        return not self._warned

    def check(self, t_s: float, quantities: Iterable[LimitedValue]) -> list[tuple[str, str]]:
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
