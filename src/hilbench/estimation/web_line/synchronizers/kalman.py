"""Kalman filters on the momentum balance of axis 2, compiled; `ekf` runs one of them, `changepoint` a bank.

State of a filter: position (m) and velocity (m/s) of roller 2; E and its rate over a reference E; torque offset of axis
2 (N·m, motor side), viscous (N·s/m) and dry friction (N) at the web, relative error of the moving mass. The measured
torque is the input, its noise the process noise; the encoder is the measurement. So no velocity is differentiated, and
a change of E is weighed against the motion that it causes. Joint state and parameters: Boulter, IWEB 1999, with E, loss
torque and strain.

All filters are stepped together, each in a column of its own.
"""

from __future__ import annotations

from math import log, pi
from typing import Final

import numpy as np

from hilbench.compiled import Record, compiled, inlined
from hilbench.estimation.bank import Array, BankArrays, Places
from hilbench.estimation.correction import correct

X, V, E, RATE, OFFSET, VISCOUS, DRY, MASS = range(8)
SIZE = 8
#: Nuisance parameters, estimated in addition to E.
NUISANCES = (OFFSET, VISCOUS, DRY, MASS)
#: Inputs of a step.
INPUTS: Final = np.dtype(
    [
        ("duration_s", "f8"),
        ("mass_kg", "f8"),
        ("force_N", "f8"),
        ("web_N", "f8"),  # tension at the reference E
        ("force_per_torque", "f8"),
        ("speed_m_s", "f8"),
        ("acceleration_m_s2", "f8"),  # smoothed, for the error of the mass
        ("force_variance", "f8"),
        ("E_variance_per_s", "f8"),
        ("position_m", "f8"),
        ("position_variance", "f8"),
        ("priors", "f8", (len(NUISANCES),)),  # prior deviations, in the order of the state
    ]
)
#: Time in which a nuisance parameter may wander through its prior: a working day. Were it faster, a slow change of
#: tension could not be separated from E.
_WANDER_S = 36000.0


@compiled
def step(b: BankArrays, u: Record) -> None:
    """Predict all filters over one cycle and correct them by the position; u: `INPUTS`.

    Their states are X to RATE and the estimated NUISANCES, the others are 0. Rows SIZE + 1 and SIZE + 2 of the scratch
    return the innovations and their variances.
    """
    z, p, places, rows, g = b.z, b.p, b.places, b.work, b.work[SIZE + 3 :, 0]
    dt, mass, speed, count, size = u.duration_s, u.mass_kg, u.speed_m_s, z.shape[1], z.shape[0]
    sign = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else 0.0)
    g[E], g[OFFSET], g[VISCOUS] = -u.web_N / mass, -u.force_per_torque / mass, -speed / mass
    g[DRY], g[MASS] = -sign / mass, -u.acceleration_m_s2
    half, own, beside = 0.5 * dt * dt, u.force_N / mass, rows[size + 1]
    rate = rows[size + 2]
    for i in range(count):
        rate[i] = own + g[E] * z[E, i]
        beside[i] = 0.0
    for m in range(OFFSET, len(places)):
        j = places[m]
        for i in range(count):
            beside[i] += g[j] * z[j, i]
    for i in range(count):
        rate[i] += beside[i]
    for i in range(count):
        z[X, i] += dt * z[V, i] + half * rate[i]
        z[V, i] += dt * rate[i]
        z[E, i] += dt * z[RATE, i]
    for m in range(len(places)):
        _accelerated(p, g, places, rows, places[m], True)
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            p[X, j, i] += dt * p[V, j, i] + half * rows[j, i]
        for i in range(count):
            p[V, j, i] += dt * rows[j, i]
        for i in range(count):
            p[E, j, i] += dt * p[RATE, j, i]
    for m in range(len(places)):
        _accelerated(p, g, places, rows, places[m], False)
    for m in range(len(places)):
        j = places[m]
        for i in range(count):
            p[j, X, i] += dt * p[j, V, i] + half * rows[j, i]
        for i in range(count):
            p[j, V, i] += dt * rows[j, i]
        for i in range(count):
            p[j, E, i] += dt * p[j, RATE, i]
    by_x, by_v = half / mass, dt / mass
    for i in range(count):
        p[X, X, i] += by_x * by_x * u.force_variance
        p[X, V, i] += by_x * by_v * u.force_variance
        p[V, X, i] += by_x * by_v * u.force_variance
        p[V, V, i] += by_v * by_v * u.force_variance
        p[E, E, i] += dt * u.E_variance_per_s
    # Nuisance parameters wander within their prior: weak evidence is forgotten again, so that inseparable ones keep
    # their prior deviation, and E with them.
    keep = 1.0 - dt / _WANDER_S
    for m in range(OFFSET, len(places)):
        j = places[m]
        prior = u.priors[j - OFFSET]
        if prior > 0.0:
            for i in range(count):
                z[j, i] *= keep
            for n in range(len(places)):
                k = places[n]
                for i in range(count):
                    p[j, k, i] *= keep
                for i in range(count):
                    p[k, j, i] *= keep
            for i in range(count):
                p[j, j, i] += 2.0 * dt / _WANDER_S * prior * prior
    innovation, variance = rows[size + 1], rows[size + 2]
    for i in range(count):
        innovation[i] = u.position_m - z[X, i]
        variance[i] = p[X, X, i] + u.position_variance
    correct(z, p, rows, places, X, innovation, variance)
    for i in range(count):
        b.likelihoods[i] = -0.5 * (innovation[i] * innovation[i] / variance[i] + log(2.0 * pi * variance[i]))


@inlined
def _accelerated(p: Array, g: Array, places: Places, rows: Array, j: int, down: bool) -> None:
    """Product of g with column j of all covariances, or with row j (not `down`), into rows[j]."""
    count, size = rows.shape[1], p.shape[0]
    for i in range(count):
        rows[j, i] = g[E] * (p[E, j, i] if down else p[j, E, i])
    second = rows[size]
    for i in range(count):
        second[i] = 0.0
    for m in range(OFFSET, len(places)):
        k = places[m]
        to = rows[j] if k < DRY else second
        for i in range(count):
            to[i] += g[k] * (p[k, j, i] if down else p[j, k, i])
    for i in range(count):
        rows[j, i] += second[i]


@compiled
def spread_of_e(p: Array, i: int) -> float:
    """Variance of E in filter `i` by noise alone, without that of nuisance parameters."""
    variance = p[E, E, i]
    for j in range(OFFSET, SIZE):
        if p[j, j, i] > 0.0:
            variance -= p[E, j, i] * p[E, j, i] / p[j, j, i]
    return float(max(variance, 0.0))


def new_filter(z: Array, p: Array, i: int, position_m: float, modulus_deviation: float, priors: Array) -> None:
    """Start filter `i` at rest at the reference E; `priors`: deviations of NUISANCES."""
    z[:, i] = 0.0
    z[X, i], z[E, i] = position_m, 1.0
    p[:, :, i] = 0.0
    p[X, X, i] = 1e-8
    p[V, V, i] = 1.0
    p[E, E, i] = modulus_deviation**2
    for place, deviation in zip(NUISANCES, priors, strict=True):
        p[place, place, i] = deviation**2


def lose_motion(p: Array) -> None:
    """Reset position and velocity of every filter to unknown."""
    for place in (X, V):
        p[place, :, :] = 0.0
        p[:, place, :] = 0.0
        p[place, place, :] = 1.0
