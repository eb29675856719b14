"""Outlook of futures: courses with bands, and the probability that a limit will be crossed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal

import numpy as np

from hilbench.arrays import Array

Level = Literal["warning", "trip"]
LEVELS: Final[tuple[Level, Level]] = ("warning", "trip")


@dataclass(frozen=True, slots=True)
class WatchedQuantity:
    """Quantity with limits: its name in messages, its signal, its unit, and levels of its size."""

    name: str
    signal: str
    unit: str
    warning: float | None = None
    trip: float | None = None

    def level(self, level: Level) -> float | None:
        """Level by its name; None where there is none."""
        return self.warning if level == "warning" else self.trip


@dataclass(frozen=True, slots=True)
class Crossing:
    """Predicted crossing of a level by a quantity's size: its probability, and its time if it occurs (experiment time,
    s: median, and the times before and after which one future in ten crosses it)."""

    watched: WatchedQuantity
    level: Level
    limit: float
    probability: float
    expected_s: float
    earliest_s: float
    latest_s: float

    def __str__(self) -> str:
        unit = f" {self.watched.unit}".rstrip()
        return f"{self.watched.name} beyond its {self.level} level {self.limit:g}{unit}"

    def expected_from(self, now_s: float) -> str:
        """When to expect it, and how likely it is."""
        return f"{self} in {self.expected_s - now_s:.1f} s, probability {100 * self.probability:.0f} %"


@dataclass(frozen=True)
class Outlook:
    """Outlook of B futures from `now_s` (experiment time) on, of Q quantities.

    `times_s` (R,) of the `rows` (R, B, Q); `largest` (B, Q): size over the whole horizon, both without measurement
    noise. `probability` (Q, 2), noise included, and `first_s` (B, Q, 2; NaN if not) of crossing the warning level and
    the trip level. `noise` (Q,): deviation of one measured sample.
    """

    now_s: float
    watched: Sequence[WatchedQuantity]
    times_s: Array
    rows: Array
    largest: Array
    probability: Array
    first_s: Array
    noise: Array

    def place(self, signal: str) -> int:
        """Index of the quantity of a signal. Raises KeyError."""
        for place, watched in enumerate(self.watched):
            if watched.signal == signal:
                return place
        raise KeyError(signal)

    def band(self, place: int, share: float = 0.9) -> tuple[Array, Array, Array]:
        """Low, median and high (R,) of a quantity: `share` of the measurements will be between low and high.

        The width is that of `share` of the futures, combined with the independent noise.
        """
        tail = 0.5 * (1.0 - share)
        low, median, high = np.quantile(self.rows[:, :, place], (tail, 0.5, 1.0 - tail), axis=1)
        noise = float(self.noise[place]) * NormalDist().inv_cdf(1.0 - tail)
        return median - np.hypot(median - low, noise), median, median + np.hypot(high - median, noise)

    def crossings(self, above: float = 0.0) -> Iterator[Crossing]:
        """Crossings of all existing levels with a probability of at least `above`, and above 0."""
        for place, column in zip(*np.nonzero((self.probability >= above) & (self.probability > 0.0)), strict=True):
            watched, level = self.watched[place], LEVELS[column]
            limit = watched.level(level)
            if limit is None:
                continue
            first = self.first_s[:, place, column]
            crossed = first[~np.isnan(first)]
            end_s = float(self.times_s[-1])
            times = np.quantile(crossed, (0.5, 0.1, 0.9)) if len(crossed) else np.full(3, end_s)
            probability = float(self.probability[place, column])
            yield Crossing(watched, level, limit, probability, *(float(time) for time in times))
