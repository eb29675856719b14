"""Kalman filters on the momentum balance of a shaft, compiled; `inertia` runs a bank of them.

    v' = β·(τ − Σ q_k·r_k)/J0,   β = J0/J

State of a filter: position (rad) and speed (rad/s); β and its rate; q (K,), torque errors beyond the model: offset
(N·m), viscous (N·m·s/rad) and dry friction (N·m), unbalance (N·m, sine and cosine), each with its regressor r_k. The
measured torque is the input, its noise the process noise; the encoder is the measurement.

The sensitivity to β is the acceleration. That by the measured torque is noise while the shaft turns evenly, and the
square of noise would count as information on the inertia. So the encoder's is used, which is independent of the
torque's noise, and zero where it is not beyond its own.

Likewise the likelihood: the noise of the torque is of its measurement, and a heavy shaft would explain best, whatever
moves it, that the encoder does not follow it. So the variance of the innovation is compared with that of a filter of
the same β that knows everything else, and steady motion is no evidence of β at all.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Final

import numpy as np

from hilbench.compiled import Record, compiled, inlined
from hilbench.estimation.bank import Array, BankArrays
from hilbench.estimation.correction import correct

X, V, BETA, RATE, Q = range(5)
#: Torque offset, viscous and dry friction, sine and cosine of an unbalance.
TERMS: Final = 5
SIZE: Final = Q + TERMS
#: Inputs of a step.
INPUTS: Final = np.dtype(
    [
        ("duration_s", "f8"),
        ("inertia_kg_m2", "f8"),  # J0
        ("torque_Nm", "f8"),  # mean over the cycle, without the model's friction
        ("acceleration_rad_s2", "f8"),  # of the encoder; 0 within its noise
        ("torque_variance", "f8"),
        ("beta_variance_per_s", "f8"),  # of its random walk
        ("beta_bound", "f8"),  # bound of that variance
        ("position_rad", "f8"),
        ("position_variance", "f8"),
        ("drift_s", "f8"),  # decay time of a drift
        ("regressors", "f8", (TERMS,)),
        ("memories_s", "f8", (TERMS,)),
        ("priors", "f8", (TERMS,)),
    ]
)
#: Least β: no shaft is so much heavier than the model's.
_LEAST_BETA = 0.02


@inlined
def _known_variance(acceleration_rad_s2: float, dt_s: float, position_variance: float) -> float:
    """Variance of the innovations of a steady filter of position and speed, acceleration and position noisy.

    The closed form of Kalata (1984) by the tracking index.
    """
    index = acceleration_rad_s2 * dt_s * dt_s / sqrt(position_variance)
    # (4 + Λ − √(Λ² + 8Λ))/4, without the cancellation at large Λ.
    root = 4.0 / (4.0 + index + sqrt(index * index + 8.0 * index))
    return position_variance / (root * root)


@inlined
def wandered(variance: float, added: float, bound: float) -> float:
    """Growth of a variance by a random walk of `added`, decreasing towards the bound."""
    return float(added * max(1.0 - variance / bound, 0.0))


@compiled
def step(b: BankArrays, u: Record) -> None:
    """Predict all filters over one cycle and correct them by the position; u: `INPUTS`. The log likelihoods are 0
    without acceleration."""
    z, p, places, rows, g = b.z, b.p, b.places, b.work[: SIZE + 3], b.work[SIZE + 3 :]
    dt, count = u.duration_s, z.shape[1]
    half = 0.5 * dt * dt
    # In quiet time a drift is not observable: the estimate of the inertia stays.
    drifting = dt if u.acceleration_rad_s2 != 0.0 else 0.0
    curved, per_torque = rows[SIZE + 1], rows[SIZE + 2]
    for i in range(count):
        beta = max(z[BETA, i], _LEAST_BETA)
        per_torque[i] = beta / u.inertia_kg_m2
        # Nonlinearity in β, as noise: a filter that is 20 % off must not call its first correction exact.
        curved[i] = u.acceleration_rad_s2 * p[BETA, BETA, i] / (beta * beta)
        net = u.torque_Nm
        for k in range(TERMS):
            net -= u.regressors[k] * z[Q + k, i]
            g[Q + k, i] = -per_torque[i] * u.regressors[k]
        g[BETA, i] = u.acceleration_rad_s2 / beta
        rate = per_torque[i] * net
        z[X, i] += dt * z[V, i] + half * rate
        z[V, i] += dt * rate
        z[BETA, i] += drifting * z[RATE, i]
    for j in range(SIZE):
        for i in range(count):
            rows[j, i] = g[BETA, i] * p[BETA, j, i]
        for k in range(Q, SIZE):
            for i in range(count):
                rows[j, i] += g[k, i] * p[k, j, i]
    for j in range(SIZE):
        for i in range(count):
            p[X, j, i] += dt * p[V, j, i] + half * rows[j, i]
            p[V, j, i] += dt * rows[j, i]
            p[BETA, j, i] += drifting * p[RATE, j, i]
    for j in range(SIZE):
        for i in range(count):
            rows[j, i] = g[BETA, i] * p[j, BETA, i]
        for k in range(Q, SIZE):
            for i in range(count):
                rows[j, i] += g[k, i] * p[j, k, i]
    for j in range(SIZE):
        for i in range(count):
            p[j, X, i] += dt * p[j, V, i] + half * rows[j, i]
            p[j, V, i] += dt * rows[j, i]
            p[j, BETA, i] += drifting * p[j, RATE, i]
    for i in range(count):
        variance = per_torque[i] * per_torque[i] * u.torque_variance + 2.0 * curved[i] * curved[i]
        p[X, X, i] += half * half * variance
        p[X, V, i] += half * dt * variance
        p[V, X, i] += half * dt * variance
        p[V, V, i] += dt * dt * variance
        p[BETA, BETA, i] += wandered(p[BETA, BETA, i], dt * u.beta_variance_per_s, u.beta_bound)
    kept = 1.0 - dt / u.drift_s
    for i in range(count):
        z[RATE, i] *= kept
    for k in range(SIZE):
        for i in range(count):
            p[RATE, k, i] *= kept
        for i in range(count):
            p[k, RATE, i] *= kept
    # Weak evidence is forgotten again: what the data don't identify returns to its prior.
    for j in range(Q, SIZE):
        prior, gone = u.priors[j - Q], dt / u.memories_s[j - Q]
        left = 1.0 - gone
        if prior > 0.0:
            for i in range(count):
                z[j, i] *= left
            for k in range(SIZE):
                for i in range(count):
                    p[j, k, i] *= left
                for i in range(count):
                    p[k, j, i] *= left
            for i in range(count):
                p[j, j, i] += 2.0 * gone * prior * prior
    innovation, variances = rows[SIZE + 1], g[X]
    for i in range(count):
        innovation[i] = u.position_rad - z[X, i]
        variances[i] = p[X, X, i] + u.position_variance
    correct(z, p, rows, places, X, innovation, variances)
    for i in range(count):
        b.likelihoods[i] = 0.0
        if u.acceleration_rad_s2 != 0.0:
            known = _known_variance(per_torque[i] * sqrt(u.torque_variance), dt, u.position_variance)
            variance = variances[i]
            b.likelihoods[i] = -0.5 * (innovation[i] * innovation[i] / variance + log(variance / known))


def new_filter(z: Array, p: Array, i: int, deviation: float, priors: Array) -> None:
    """Start filter `i` at the model's inertia; `deviation` of β, `priors` (TERMS,) of the nuisance parameters."""
    z[:, i] = 0.0
    z[BETA, i] = 1.0
    p[:, :, i] = np.diag([0.0, 0.0, deviation**2, 0.0, *priors**2])


def place_motion(z: Array, p: Array, position_rad: float, speed_rad_s: float) -> None:
    """Reset the motion of every filter to this; the next step corrects it by the following position."""
    z[X], z[V] = position_rad, speed_rad_s
    for place, variance in ((X, 1e-8), (V, 1.0)):
        p[place, :, :] = 0.0
        p[:, place, :] = 0.0
        p[place, place, :] = variance
