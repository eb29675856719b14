"""Noise variance of a signal, from its fourth differences: smooth motion and steps hardly count; compiled."""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import REAL, VECTOR, compiled, entry_point, inlined
from hilbench.estimation.assumptions import MOST_SQUARE

#: Sum of the squares of the binomials 1 4 6 4 1: variance of a fourth difference of white noise.
_GAIN = 70.0
_DIFFERENCES = 4
#: Samples that are not limited so.
_SETTLE = 30
# State: the last samples, newest first (4 places); samples whose differences span a gap.
_PAST, _VARIANCE, _COUNT, _APART, _SHARE, _FLOOR, _EXPECTED = 0, 4, 5, 6, 7, 8, 9
SIZE = 10  #: of a state


@compiled
def take(s: Array, value: float) -> None:
    """Take one sample; non-finite ones are skipped. s: state of a `NoiseLevel`."""
    if not isfinite(value):
        return
    difference = value - 4.0 * s[0] + 6.0 * s[1] - 4.0 * s[2] + s[3]
    for i in range(3, 0, -1):
        s[i] = s[i - 1]
    s[0] = value
    if s[_APART] > 0.0:
        s[_APART] -= 1.0
        return
    count = s[_COUNT]
    s[_COUNT] = count + 1.0
    if count < _DIFFERENCES:
        return
    square = difference * difference / _GAIN
    n = count - 3.0
    weight = max(1.0 / n, s[_SHARE])
    if n >= _SETTLE:
        square = min(square, MOST_SQUARE * s[_VARIANCE])
    s[_VARIANCE] = max(s[_VARIANCE] + weight * (square - s[_VARIANCE]), s[_FLOOR] * s[_FLOOR])


@inlined
def variance(s: Array) -> float:
    """Variance of the noise, unit of the signal squared; the expected one until it is measured."""
    return float(s[_VARIANCE] if s[_COUNT] > _SETTLE else s[_EXPECTED])


@inlined
def is_known(s: Array) -> bool:
    """True if the variance is measured, and not the expected one."""
    return bool(s[_COUNT] > _SETTLE)


@inlined
def interrupt(s: Array) -> None:
    """Form no difference across a gap before the next sample."""
    s[_APART] = _DIFFERENCES


@entry_point(VECTOR, REAL)
def _take(s: Array, value: float) -> None:
    take(s, value)


class NoiseLevel:
    """Running estimate of the variance of white noise on a sampled signal.

    `expected` is used until the first samples are in; the estimate never falls below `floor` (both standard deviations,
    unit of the signal). `memory`: number of samples averaged.
    """

    def __init__(self, expected: float, floor: float, memory: int = 500) -> None:
        self.state = np.zeros(SIZE)
        self.state[_VARIANCE] = self.state[_EXPECTED] = expected**2
        self.state[_SHARE], self.state[_FLOOR] = 1.0 / memory, floor

    def update(self, value: float) -> None:
        """Take one sample; non-finite ones are skipped."""
        _take(self.state, value)

    @property
    def variance(self) -> float:
        """Variance of the noise, unit of the signal squared."""
        return self.state.item(_VARIANCE if self.state.item(_COUNT) > _SETTLE else _EXPECTED)

    @property
    def deviation(self) -> float:
        """Standard deviation of the noise, unit of the signal."""
        return sqrt(self.variance)
