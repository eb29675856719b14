"""Kalman filters on the momentum balance of a shaft, compiled; `inertia` runs a bank of them.

    v' = β·(τ − Σ q_k·r_k)/J0,   β = J0/J

State of a filter, as of `motion_filter`: position (rad) and speed (rad/s); β and its rate; q (K,), torque errors beyond
the model: offset (N·m), viscous (N·m·s/rad) and dry friction (N·m), unbalance (N·m, sine and cosine), each with its
regressor r_k. The measured torque is the input, its noise the process noise; the encoder is the measurement.

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

from hilbench.compiled import Record, compiled
from hilbench.estimation.bank import BankArrays
from hilbench.estimation.motion_filter import COMMON, NUISANCE, PARAMETER, X, advance

BETA, Q = PARAMETER, NUISANCE
#: Torque offset, viscous and dry friction, sine and cosine of an unbalance.
TERMS: Final = 5
SIZE: Final = Q + TERMS
#: Inputs of a step.
INPUTS: Final = np.dtype(
    [
        *COMMON,
        ("inertia_kg_m2", "f8"),  # J0
        ("torque_Nm", "f8"),  # mean over the cycle, without the model's friction
        ("acceleration_rad_s2", "f8"),  # of the encoder; 0 within its noise
        ("torque_variance", "f8"),
        ("regressors", "f8", (TERMS,)),
    ]
)
#: Least β: no shaft is 50 times as heavy as the model's. Where the mixture is not above it the estimate is invalid.
LEAST_BETA = 0.02


@compiled
def step(b: BankArrays, u: Record) -> None:
    """Step all filters by one cycle; u: `INPUTS`. The log likelihoods are 0 without acceleration."""
    z, p, g, rows, dt = b.z, b.p, b.work[SIZE + 3 :], b.work, u.duration_s
    rate, noise, per_torque = rows[SIZE + 1], rows[SIZE + 2], g[X]
    for i in range(z.shape[1]):
        beta = max(z[BETA, i], LEAST_BETA)
        per_torque[i] = beta / u.inertia_kg_m2
        # Nonlinearity in β, as noise: a filter that is 20 % off must not call its first correction exact.
        curved = u.acceleration_rad_s2 * p[BETA, BETA, i] / (beta * beta)
        net = u.torque_Nm
        for k in range(TERMS):
            net -= u.regressors[k] * z[Q + k, i]
            g[Q + k, i] = -per_torque[i] * u.regressors[k]
        g[BETA, i] = u.acceleration_rad_s2 / beta
        rate[i] = per_torque[i] * net
        noise[i] = per_torque[i] * per_torque[i] * u.torque_variance + 2.0 * curved * curved
    # In quiet time a drift is not observable: the estimate of the inertia stays.
    advance(b, u, 0.5 * dt * dt, dt, dt if u.acceleration_rad_s2 != 0.0 else 0.0)
    innovation, variances = rate, noise
    for i in range(z.shape[1]):
        b.likelihoods[i] = 0.0
        if u.acceleration_rad_s2 != 0.0:
            # Variance of the innovations of a steady filter of position and speed, acceleration and position noisy: the
            # closed form of Kalata (1984) by the tracking index Λ, without the cancellation of (4 + Λ − √(Λ² + 8Λ))/4.
            index = per_torque[i] * sqrt(u.torque_variance) * dt * dt / sqrt(u.position_variance)
            root = 4.0 / (4.0 + index + sqrt(index * index + 8.0 * index))
            known = u.position_variance / (root * root)
            variance = variances[i]
            b.likelihoods[i] = -0.5 * (innovation[i] * innovation[i] / variance + log(variance / known))
