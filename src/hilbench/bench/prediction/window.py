"""Window of the last cycles of some signals: their present values with less noise, and the noise variance."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.topology.sample import CycleSample

#: Cycles of which a straight line is fitted.
CYCLES: Final = 20
#: Of the mean square of noise: weight of the latest cycles in it.
_NEW: Final = 0.2


class Window:
    """The last `CYCLES` + 1 cycles of these signals."""

    def __init__(self, signals: Sequence[str]) -> None:
        self._places = {signal: place for place, signal in enumerate(signals)}
        self._values = attrgetter(*signals)
        self._rows = np.zeros((CYCLES + 1, len(signals)))
        self._count = 0
        self._variance: Array | None = None
        time = np.arange(CYCLES) - (CYCLES - 1) / 2
        #: Weights of the fitted line's value at its last point.
        self._weights = 1.0 / CYCLES + time[-1] * time / np.sum(time**2)

    def add(self, sample: CycleSample) -> None:
        """The next cycle."""
        self._rows[self._count % len(self._rows)] = self._values(sample)
        self._count += 1

    def clear(self) -> None:
        """Clear the window: earlier cycles are not used any more."""
        self._count = 0

    @property
    def full(self) -> bool:
        """True if the window is full."""
        return self._count >= len(self._rows)

    def read(self) -> Reading:
        """Reading of the signals now."""
        rows = np.roll(self._rows, -(self._count % len(self._rows)), axis=0)
        # Of second differences of white noise the mean square is six times its variance; what moves smoothly has none.
        found = np.mean(np.diff(rows, 2, axis=0) ** 2, axis=0) / 6.0
        self._variance = found if self._variance is None else self._variance + _NEW * (found - self._variance)
        return Reading(
            self._places,
            rows,
            self._weights @ rows[1:],
            self._weights @ rows[:-1],
            np.sqrt(self._variance),
        )

    @property
    def fit_noise(self) -> float:
        """Deviation of a fitted value, as a share of that of a sample."""
        return float(np.sqrt(np.sum(self._weights**2)))


class Reading:
    """Signals at one time, by name."""

    def __init__(self, places: dict[str, int], rows: Array, fitted: Array, before: Array, noise: Array) -> None:
        self._places = places
        self._rows, self._fitted, self._before, self._noise = rows, fitted, before, noise

    def last(self, *signals: str) -> Array:
        """Values sampled in the last cycle."""
        return self.ago(0, *signals)

    def ago(self, cycles: int, *signals: str) -> Array:
        """Values sampled so many cycles (up to `CYCLES`) before the last."""
        return self._rows[-1 - cycles, [self._places[signal] for signal in signals]]

    def fitted(self, *signals: str) -> Array:
        """Values in the last cycle by a straight line through the last `CYCLES`."""
        return self._fitted[[self._places[signal] for signal in signals]]

    def before(self, *signals: str) -> Array:
        """Fitted values a cycle before."""
        return self._before[[self._places[signal] for signal in signals]]

    def noise(self, *signals: str) -> Array:
        """Standard deviation of a sample."""
        return self._noise[[self._places[signal] for signal in signals]]
