"""Matrix exponential of a small matrix: scaling and squaring with the Padé approximant of order 13.

N. J. Higham, The scaling and squaring method for the matrix exponential revisited, SIAM J. Matrix Anal. Appl. 26(4),
2005. Equivalent to `scipy.linalg.expm`, but importing scipy would dominate the start of a bench.
"""

from __future__ import annotations

from math import ceil, factorial, log2

import numpy as np
from numpy.typing import NDArray

_ORDER = 13
#: 1-norm up to which the approximant is exact to a double's precision (Higham, table 2.3).
_LARGEST = 5.371920351148152
_COEFFICIENTS = [
    factorial(2 * _ORDER - k) / (factorial(2 * _ORDER) / factorial(_ORDER)) / factorial(k) / factorial(_ORDER - k)
    for k in range(_ORDER + 1)
]


def matrix_exponential(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exponential exp(A) of a square matrix (n, n) of finite numbers."""
    size = float(np.linalg.norm(matrix, 1))
    squarings = max(0, ceil(log2(size / _LARGEST))) if size > 0.0 else 0
    scaled = matrix / 2.0**squarings
    square, even, odd = scaled @ scaled, np.zeros_like(scaled), np.zeros_like(scaled)
    power = np.eye(len(scaled))
    for k in range(0, _ORDER, 2):
        even += _COEFFICIENTS[k] * power
        odd += _COEFFICIENTS[k + 1] * power
        power = power @ square
    odd = scaled @ odd
    return np.asarray(np.linalg.matrix_power(np.linalg.solve(even - odd, even + odd), 2**squarings))
