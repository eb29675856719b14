"""Residual of predictions against measurements: its lasting part corrects the next predictions."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.prediction.outlook import Outlook

#: Lead at which a prediction is compared with the measurement, s.
_LEAD_S: Final = 0.5
#: Timing tolerance of a prediction: the error that it explains at the end of a ramp is not lasting, s.
_EARLY_OR_LATE_S: Final = 0.1
#: Weight of the latest comparison in the lasting difference, and in its mean square.
_NEW: Final = 0.1


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
            new = max(_NEW, 1.0 / self._compared)
            self.lasting[places] += new * (difference - self.lasting[places])
            self._square[places] += new * ((difference - self.lasting[places]) ** 2 - self._square[places])

    def clear(self) -> None:
        """Drop the predictions that are due: an event has made them incomparable."""
        self._due.clear()
