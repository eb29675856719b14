"""The last cycles of some signals: their present values with less noise, the noise variance; and the residual of
predictions against measurements, whose lasting part corrects the next predictions."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from operator import attrgetter
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.prediction.outlook import Outlook
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


#: Lead at which a prediction is compared with the measurement, s.
_LEAD_S: Final = 0.5
#: Timing tolerance of a prediction: the error that it explains at the end of a ramp is not lasting, s.
_EARLY_OR_LATE_S: Final = 0.1
#: Weight of the latest comparison in the lasting difference, and in its mean square.
_NEW_COMPARISON: Final = 0.1


class Hindsight:
    """Lasting residuals of Q quantities; those that are not compared have none."""

    def __init__(self, quantities: int) -> None:
        self.lasting = np.zeros(quantities)
        self._square = np.zeros(quantities)
        self._due: deque[tuple[float, Outlook, Array]] = deque()  # when, what, and what was added to it as lasting
        self._compared = 0

    @property
    def deviation(self) -> Array:
        """Deviation of single comparisons from the lasting residual."""
        return np.sqrt(self._square)

    def expect(self, outlook: Outlook) -> None:
        """Keep a prediction for comparison, with the lasting residual of now."""
        self._due.append((outlook.now_s + _LEAD_S, outlook, self.lasting.copy()))

    def compare(self, now_s: float, measured: Array, places: Array) -> None:
        """Compare measurements of the quantities at `places` with predictions for now, once these are due."""
        while self._due and self._due[0][0] <= now_s:
            _, outlook, lasting = self._due.popleft()
            near = np.abs(outlook.times_s - now_s) <= _EARLY_OR_LATE_S
            if not near.any():
                continue
            predicted = np.median(outlook.rows[near], axis=1)[:, places]
            came = measured[places] + lasting[places]
            difference = came - np.clip(came, predicted.min(axis=0), predicted.max(axis=0))
            self._compared += 1
            new = max(_NEW_COMPARISON, 1.0 / self._compared)
            self.lasting[places] += new * (difference - self.lasting[places])
            self._square[places] += new * ((difference - self.lasting[places]) ** 2 - self._square[places])

    def clear(self) -> None:
        """Drop the predictions that are due: an event has made them incomparable."""
        self._due.clear()
