"""The measurement update of a Kalman filter that observes one of its states: every filter here watches an encoder."""

from __future__ import annotations

from hilbench.compiled import inlined
from hilbench.estimation.bank import Array


@inlined
def correct(
    z: Array, p: Array, row: Array, i: int, size: int, observed: int, innovation: float, variance: float
) -> None:
    """Correct filter `i` by what state `observed` was measured as.

    z (H, size), p (H, size, size): means and covariances of all filters, changed in place; row (size,): scratch;
    `innovation`: measured less predicted, of this `variance` (the prediction's and the measurement's).
    """
    for j in range(size):
        row[j] = p[i, j, observed]
    for j in range(size):
        gain = row[j] / variance
        z[i, j] += gain * innovation
        for k in range(size):
            p[i, j, k] -= gain * row[k]
    for j in range(size):  # rounding must not make it unsymmetric
        for k in range(j):
            mean = 0.5 * (p[i, j, k] + p[i, k, j])
            p[i, j, k] = mean
            p[i, k, j] = mean
