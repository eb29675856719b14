"""Kalman filters of position, speed, a parameter with its rate, and nuisance parameters, by positions; compiled.

    x' = v,   v' = a + noise,   θ' = its rate,   a by the measured torque with its noise; g = ∂a/∂(θ, nuisances)

What is moved, by which law, is the caller's: `web_line.synchronizers.kalman` (E of a web) and `servo_axis.kalman`
(inertia of a shaft) set accelerations and sensitivities, and all filters of a bank are stepped together, each in a
column of its own; the columns are the last dimension for vectorization (SIMD). So no velocity is differentiated, and a
change of the parameter is weighed against the motion that it causes.
"""

from __future__ import annotations

from math import inf
from typing import Final

from hilbench.arrays import Array
from hilbench.compiled import Record, compiled, inlined
from hilbench.estimation.bank import BankArrays, Places

X, V, PARAMETER, RATE, NUISANCE = range(5)
#: Most nuisance parameters of a filter.
MOST_NUISANCES: Final = 5
#: Fields that the inputs of every kind of filter have.
COMMON: Final = [
    ("duration_s", "f8"),
    ("parameter_variance_per_s", "f8"),  # of its random walk
    ("parameter_bound", "f8"),  # bound of that variance
    ("drift_s", "f8"),  # decay time of a drift; inf: it lasts
    ("position", "f8"),
    ("position_variance", "f8"),
    ("memories_s", "f8", (MOST_NUISANCES,)),  # time in which a nuisance parameter may wander through its prior
    ("priors", "f8", (MOST_NUISANCES,)),  # prior deviations of the nuisance parameters; 0: not estimated
]


@inlined
def wandered(variance: float, added: float, bound: float) -> float:
    """Growth of a variance by a random walk of `added`, decreasing towards the bound."""
    return float(added * max(1.0 - variance / bound, 0.0))


@compiled
def advance(b: BankArrays, u: Record, by_x: float, by_v: float, drifting_s: float) -> None:
    """Predict all filters over one cycle and correct them by the position; u: inputs with the fields `COMMON`.

    Of the scratch, rows size + 1 and size + 2 have the accelerations and the variances of their noise, which moves
    position and speed by `by_x` and `by_v`; rows size + 3 on, g. They return innovations and their variances.
    `drifting_s`: time for which the parameter has followed its rate.
    """
    z, p, places, rows, size, count = b.z, b.p, b.places, b.work, b.z.shape[0], b.z.shape[1]
    dt, rate, noise = u.duration_s, rows[size + 1], rows[size + 2]
    half = 0.5 * dt * dt
    for i in range(count):
        z[X, i] += dt * z[V, i] + half * rate[i]
        z[V, i] += dt * rate[i]
        z[PARAMETER, i] += drifting_s * z[RATE, i]
    for m in range(len(places)):
        _accelerate(p, rows, places, places[m], True)
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            p[X, j, i] += dt * p[V, j, i] + half * rows[j, i]
            p[V, j, i] += dt * rows[j, i]
            p[PARAMETER, j, i] += drifting_s * p[RATE, j, i]
    for m in range(len(places)):
        _accelerate(p, rows, places, places[m], False)
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            p[j, X, i] += dt * p[j, V, i] + half * rows[j, i]
            p[j, V, i] += dt * rows[j, i]
            p[j, PARAMETER, i] += drifting_s * p[j, RATE, i]
    for i in range(count):
        p[X, X, i] += by_x * by_x * noise[i]
        p[X, V, i] += by_x * by_v * noise[i]
        p[V, X, i] += by_x * by_v * noise[i]
        p[V, V, i] += by_v * by_v * noise[i]
        walked = dt * u.parameter_variance_per_s
        p[PARAMETER, PARAMETER, i] += wandered(p[PARAMETER, PARAMETER, i], walked, u.parameter_bound)
    if u.drift_s < inf:
        _forget(b, RATE, 1.0 - dt / u.drift_s)
    # Weak evidence is forgotten again: what the data don't identify keeps its prior.
    for m in range(NUISANCE, len(places)):
        j = places[m]
        prior, gone = u.priors[j - NUISANCE], dt / u.memories_s[j - NUISANCE]
        if prior > 0.0:
            _forget(b, j, 1.0 - gone)
            for i in range(count):
                p[j, j, i] += 2.0 * gone * prior * prior
    innovation, variance = rate, noise
    for i in range(count):
        innovation[i] = u.position - z[X, i]
        variance[i] = p[X, X, i] + u.position_variance
    _correct(b, innovation, variance)


@inlined
def _accelerate(p: Array, rows: Array, places: Places, j: int, down: bool) -> None:
    """Product of g with column j of all covariances, or with row j (not `down`), into rows[j]."""
    count, first = rows.shape[1], p.shape[0] + 3
    for i in range(count):
        rows[j, i] = rows[first + PARAMETER, i] * (p[PARAMETER, j, i] if down else p[j, PARAMETER, i])
    for m in range(NUISANCE, len(places)):
        k = places[m]
        for i in range(count):
            rows[j, i] += rows[first + k, i] * (p[k, j, i] if down else p[j, k, i])


@inlined
def _forget(b: BankArrays, j: int, left: float) -> None:
    """Keep this share of a state in all filters."""
    z, p, places, count = b.z, b.p, b.places, b.z.shape[1]
    for i in range(count):
        z[j, i] *= left
    for n in range(len(places)):
        k = places[n]
        for i in range(count):
            p[j, k, i] *= left
        for i in range(count):
            p[k, j, i] *= left


@compiled
def _correct(b: BankArrays, innovation: Array, variance: Array) -> None:
    """Correct all filters by the measured position: innovations (H,) of this variance (H,), the prediction's and the
    measurement's."""
    z, p, places, rows, size, count = b.z, b.p, b.places, b.work, b.z.shape[0], b.z.shape[1]
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            rows[j, i] = p[j, X, i]
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


@compiled
def new_filter(b: BankArrays, i: int, deviation: float, priors: Array, position: float = 0.0) -> None:
    """Start filter `i` at rest with the parameter 1, of this deviation; `priors`: deviations of the nuisances."""
    z, p, size = b.z, b.p, b.z.shape[0]
    for j in range(size):
        z[j, i] = 0.0
        for k in range(size):
            p[j, k, i] = 0.0
        if j >= NUISANCE:
            p[j, j, i] = priors[j - NUISANCE] * priors[j - NUISANCE]
    z[X, i], z[PARAMETER, i] = position, 1.0
    p[X, X, i], p[V, V, i], p[PARAMETER, PARAMETER, i] = 1e-8, 1.0, deviation * deviation


@compiled
def lose_motion(b: BankArrays, position_variance: float) -> None:
    """Reset position and speed of every filter to unknown, but for the position's variance."""
    p = b.p
    for i in range(p.shape[2]):
        for j in range(p.shape[0]):
            p[X, j, i] = p[j, X, i] = p[V, j, i] = p[j, V, i] = 0.0
        p[X, X, i], p[V, V, i] = position_variance, 1.0
