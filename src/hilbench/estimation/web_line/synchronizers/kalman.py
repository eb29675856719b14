"""One Kalman filter on the momentum balance of axis 2, compiled; `ekf` runs one of them, `changepoint` a bank.

State of a filter: position (m) and velocity (m/s) of roller 2; E and its rate over a reference E; torque offset of
axis 2 (N·m, motor side), viscous (N·s/m) and dry friction (N) at the web, relative error of the moving mass. The
measured torque is the input, its noise the process noise; the encoder is the measurement. So no velocity is
differentiated, and a change of E is weighed against the motion that it causes. Joint state and parameters: Boulter,
IWEB 1999, with E, loss torque and strain.

Vectors as in the web kernel: whole arrays and an index instead of views.
"""

from __future__ import annotations

from math import log, pi

from hilbench.compiled import compiled
from hilbench.estimation.bank import Array
from hilbench.estimation.correction import correct

X, V, E, RATE, OFFSET, VISCOUS, DRY, MASS = range(8)
SIZE = 8
#: Those estimated beside E.
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
    PRIORS,  # deviations of what is estimated beside E, in the order of the state
) = range(12)
INPUTS = PRIORS + len(NUISANCES)
#: Time in which a parameter estimated beside E may wander through its prior: a working day. Were it faster, a slow
#: change of tension could not tell it from E.
_WANDER_S = 36000.0


@compiled
def step(z: Array, p: Array, i: int, u: Array, row: Array) -> float:
    """Predict filter `i` over one cycle and take in the position; returns its log likelihood. `row`: SIZE scratch."""
    dt, mass, speed = u[DURATION_S], u[MASS_KG], u[SPEED_M_S]
    sign = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else 0.0)
    g_e, g_b, g_c, g_d = -u[WEB_N] / mass, -u[FORCE_PER_TORQUE] / mass, -speed / mass, -sign / mass
    g_m = -u[ACCELERATION_M_S2]
    rate = u[FORCE_N] / mass + g_e * z[i, E]
    rate += g_b * z[i, OFFSET] + g_c * z[i, VISCOUS] + g_d * z[i, DRY] + g_m * z[i, MASS]
    half = 0.5 * dt * dt
    z[i, X] += dt * z[i, V] + half * rate
    z[i, V] += dt * rate
    z[i, E] += dt * z[i, RATE]
    for j in range(SIZE):
        row[j] = g_e * p[i, E, j] + g_b * p[i, OFFSET, j] + g_c * p[i, VISCOUS, j]
        row[j] += g_d * p[i, DRY, j] + g_m * p[i, MASS, j]
    for j in range(SIZE):
        p[i, X, j] += dt * p[i, V, j] + half * row[j]
        p[i, V, j] += dt * row[j]
        p[i, E, j] += dt * p[i, RATE, j]
    for j in range(SIZE):
        row[j] = g_e * p[i, j, E] + g_b * p[i, j, OFFSET] + g_c * p[i, j, VISCOUS]
        row[j] += g_d * p[i, j, DRY] + g_m * p[i, j, MASS]
    for j in range(SIZE):
        p[i, j, X] += dt * p[i, j, V] + half * row[j]
        p[i, j, V] += dt * row[j]
        p[i, j, E] += dt * p[i, j, RATE]
    by_x, by_v = half / mass, dt / mass
    p[i, X, X] += by_x * by_x * u[FORCE_VARIANCE]
    p[i, X, V] += by_x * by_v * u[FORCE_VARIANCE]
    p[i, V, X] += by_x * by_v * u[FORCE_VARIANCE]
    p[i, V, V] += by_v * by_v * u[FORCE_VARIANCE]
    p[i, E, E] += dt * u[E_VARIANCE_PER_S]
    # What is estimated beside E is believed to wander within its prior: weak evidence is forgotten again, so that
    # what the data can't tell apart keeps its prior deviation, and E with it.
    for j in range(OFFSET, SIZE):
        prior = u[PRIORS + j - OFFSET]
        if prior > 0.0:
            z[i, j] *= 1.0 - dt / _WANDER_S
            for k in range(SIZE):
                p[i, j, k] *= 1.0 - dt / _WANDER_S
                p[i, k, j] *= 1.0 - dt / _WANDER_S
            p[i, j, j] += 2.0 * dt / _WANDER_S * prior * prior
    innovation = u[POSITION_M] - z[i, X]
    variance = p[i, X, X] + u[POSITION_VARIANCE]
    correct(z, p, row, i, SIZE, X, innovation, variance)
    row[0], row[1] = innovation, variance
    likelihood: float = -0.5 * (innovation * innovation / variance + log(2.0 * pi * variance))
    return likelihood


@compiled
def spread_of_e(p: Array, i: int) -> float:
    """Variance of E in filter `i` that comes from noise: without what the parameters beside it may be wrong by."""
    variance = p[i, E, E]
    for j in range(OFFSET, SIZE):
        if p[i, j, j] > 0.0:
            variance -= p[i, E, j] * p[i, E, j] / p[i, j, j]
    return float(max(variance, 0.0))


def new_filter(z: Array, p: Array, i: int, position_m: float, modulus_deviation: float, priors: Array) -> None:
    """Start filter `i` at rest at the reference E; `priors`: deviations of NUISANCES."""
    z[i] = 0.0
    z[i, X], z[i, E] = position_m, 1.0
    p[i] = 0.0
    p[i, X, X] = 1e-8
    p[i, V, V] = 1.0
    p[i, E, E] = modulus_deviation**2
    for place, deviation in zip(NUISANCES, priors, strict=True):
        p[i, place, place] = deviation**2


def lose_motion(p: Array) -> None:
    """Position and velocity of every filter are unknown from here on."""
    for place in (X, V):
        p[:, place, :] = 0.0
        p[:, :, place] = 0.0
        p[:, place, place] = 1.0
