"""How noisy a signal is, from its fourth differences: smooth motion and steps hardly count."""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import entry_point

#: Sum of the squares of the binomials 1 4 6 4 1: variance of a fourth difference of white noise.
_GAIN = 70.0
_DIFFERENCES = 4
#: Squares beyond so many times the present variance count only so much, so that a step is no noise.
_LIMIT = 9.0
#: Samples that are all believed before steps are told from noise.
_SETTLE = 30


@entry_point
def _update(s: NDArray[np.float64], value: float, count: int, share: float, floor: float) -> None:
    difference = value - 4.0 * s[0] + 6.0 * s[1] - 4.0 * s[2] + s[3]
    for i in range(3, 0, -1):
        s[i] = s[i - 1]
    s[0] = value
    if count < 4:
        return
    square = difference * difference / _GAIN
    n = count - 3
    weight = max(1.0 / n, share)
    if n >= _SETTLE:
        square = min(square, _LIMIT * s[4])
    s[4] = max(s[4] + weight * (square - s[4]), floor * floor)


class NoiseLevel:
    """Running estimate of the variance of white noise on a sampled signal.

    `expected` is believed until the first samples are in; the estimate never falls below `floor` (both standard
    deviations, unit of the signal). `memory` is the number of samples that the average reaches back.
    """

    def __init__(self, expected: float, floor: float, memory: int = 500) -> None:
        self._state = np.zeros(5)
        self._state[4] = expected**2
        self._expected = expected**2
        self._floor = floor
        self._share = 1.0 / memory
        self._count = 0
        self._apart = 0  # samples whose differences reach over a gap

    def interrupt(self) -> None:
        """The next sample is not one cycle after the last: no difference is formed across the gap."""
        self._apart = _DIFFERENCES

    def update(self, value: float) -> None:
        """Take one sample; what is not finite is passed over."""
        if not isfinite(value):
            return
        if self._apart:
            self._apart -= 1
            self._state[1:4] = self._state[:3]
            self._state[0] = value
        else:
            _update(self._state, value, self._count, self._share, self._floor)
            self._count += 1

    @property
    def known(self) -> bool:
        """Whether it is measured, and not only believed."""
        return self._count > _SETTLE

    @property
    def variance(self) -> float:
        """Variance of the noise, unit of the signal squared."""
        return float(self._state[4]) if self.known else self._expected

    @property
    def deviation(self) -> float:
        """Standard deviation of the noise, unit of the signal."""
        return sqrt(self.variance)
