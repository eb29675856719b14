"""Measurement update of Kalman filters that observe one of their states: here always an encoder's position."""

from __future__ import annotations

from hilbench.compiled import compiled
from hilbench.estimation.bank import Array, Places


@compiled
def correct(z: Array, p: Array, rows: Array, places: Places, observed: int, innovation: Array, variance: Array) -> None:
    """Correct all filters by the measurement of state `observed`.

    z (size, H), p (size, size, H): means and covariances of H filters, changed in place; places: indices of their
    states, the others are 0; rows (size + 1, H): scratch; innovation (H,): measured less predicted, of this variance
    (H,), the prediction's and the measurement's. The filters are in the last dimension for vectorization (SIMD).
    """
    count, size = z.shape[1], z.shape[0]
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            rows[j, i] = p[j, observed, i]
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            rows[size, i] = rows[j, i] / variance[i]
        for i in range(count):
            z[j, i] += rows[size, i] * innovation[i]
        for n in range(len(places)):
            k = places[n]
            for i in range(count):
                p[j, k, i] -= rows[size, i] * rows[k, i]
    for m in range(len(places)):  # rounding must not make it unsymmetric
        j = places[m]
        for n in range(m):
            k = places[n]
            for i in range(count):
                mean = 0.5 * (p[j, k, i] + p[k, j, i])
                p[j, k, i] = mean
                p[k, j, i] = mean
