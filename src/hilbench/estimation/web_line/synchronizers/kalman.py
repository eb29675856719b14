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

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.correction import correct

X, V, E, RATE, OFFSET, VISCOUS, DRY, MASS = range(8)
SIZE = 8
#: Nuisance parameters, estimated in addition to E.
NUISANCES = (OFFSET, VISCOUS, DRY, MASS)
#: Inputs of a step, in this order.
(
    DURATION_S,
    MASS_KG,
    FORCE_N,
    WEB_N,  # tension at the reference E
    FORCE_PER_TORQUE,
    SPEED_M_S,
    ACCELERATION_M_S2,  # smoothed, for the error of the mass
    FORCE_VARIANCE,
    E_VARIANCE_PER_S,
    POSITION_M,
    POSITION_VARIANCE,
    PRIORS,  # prior deviations of the nuisance parameters, in the order of the state
) = range(12)
INPUTS = PRIORS + len(NUISANCES)
#: Time in which a nuisance parameter may wander through its prior: a working day. Were it faster, a slow change of
#: tension could not be separated from E.
_WANDER_S = 36000.0


@compiled
def step(z: Array, p: Array, u: Array, places: Places, g: Array, rows: Array, likelihoods: Array) -> None:
    """Predict all filters over one cycle and correct them by the position.

    z (SIZE, H), p (SIZE, SIZE, H): means and covariances of H filters; u (INPUTS,); places: indices of their states, X
    to RATE and the estimated NUISANCES, the others are 0; g (SIZE,) and rows (SIZE + 3, H): scratch, whose last two
    rows return innovations and their variances; likelihoods (H,) returns the log likelihoods.
    """
    dt, mass, speed, count, size = u[DURATION_S], u[MASS_KG], u[SPEED_M_S], z.shape[1], z.shape[0]
    sign = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else 0.0)
    g[E], g[OFFSET], g[VISCOUS] = -u[WEB_N] / mass, -u[FORCE_PER_TORQUE] / mass, -speed / mass
    g[DRY], g[MASS] = -sign / mass, -u[ACCELERATION_M_S2]
    half, own, beside = 0.5 * dt * dt, u[FORCE_N] / mass, rows[size + 1]
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
        p[X, X, i] += by_x * by_x * u[FORCE_VARIANCE]
        p[X, V, i] += by_x * by_v * u[FORCE_VARIANCE]
        p[V, X, i] += by_x * by_v * u[FORCE_VARIANCE]
        p[V, V, i] += by_v * by_v * u[FORCE_VARIANCE]
        p[E, E, i] += dt * u[E_VARIANCE_PER_S]
    # Nuisance parameters wander within their prior: weak evidence is forgotten again, so that inseparable ones keep
    # their prior deviation, and E with them.
    keep = 1.0 - dt / _WANDER_S
    for m in range(OFFSET, len(places)):
        j = places[m]
        prior = u[PRIORS + j - OFFSET]
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
        innovation[i] = u[POSITION_M] - z[X, i]
        variance[i] = p[X, X, i] + u[POSITION_VARIANCE]
    correct(z, p, rows, places, X, innovation, variance)
    for i in range(count):
        likelihoods[i] = -0.5 * (innovation[i] * innovation[i] / variance[i] + log(2.0 * pi * variance[i]))


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


def places_of(priors: Array) -> Places:
    """Indices of a filter's states; `priors`: deviations of NUISANCES, 0 of one that is not estimated."""
    return np.array([X, V, E, RATE, *(np.flatnonzero(priors) + OFFSET)], np.int64)


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
