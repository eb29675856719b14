"""How far what was predicted is from what came: the lasting part goes into what is predicted next."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.prediction.outlook import Outlook

Array = NDArray[np.float64]

#: How far ahead a prediction is compared with what came, s.
_LEAD_S: Final = 0.5
#: Weight of the latest comparison in the lasting difference, and in its mean square.
_NEW: Final = 0.1


class Hindsight:
    """Of Q quantities; those that are not compared have no difference."""

    def __init__(self, quantities: int) -> None:
        self.lasting = np.zeros(quantities)
        self._square = np.zeros(quantities)
        self._due: deque[tuple[float, Array]] = deque()
        self._compared = 0

    @property
    def deviation(self) -> Array:
        """Of what is lasting: how far single comparisons are from it."""
        return np.sqrt(self._square)

    def expect(self, outlook: Outlook) -> None:
        """What was predicted, without what was added as lasting."""
        row = int(np.searchsorted(outlook.times_s, outlook.now_s + _LEAD_S))
        if row < len(outlook.times_s):
            median = np.median(outlook.rows[row], axis=0) - self.lasting
            self._due.append((float(outlook.times_s[row]), median))

    def compare(self, now_s: float, measured: Array, places: Array) -> None:
        """What has come, of the quantities at `places`: with the predictions for now, as soon as it is their time."""
        while self._due and self._due[0][0] <= now_s:
            _, predicted = self._due.popleft()
            difference = measured[places] - predicted[places]
            self._compared += 1
            new = max(_NEW, 1.0 / self._compared)
            self.lasting[places] += new * (difference - self.lasting[places])
            self._square[places] += new * ((difference - self.lasting[places]) ** 2 - self._square[places])

    def clear(self) -> None:
        """What is due is not compared any more: something else has come between."""
        self._due.clear()
