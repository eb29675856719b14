"""Kalman filters on the momentum balance of axis 2, compiled; `ekf` runs one of them, `changepoint` a bank.

    v' = (F − E·h − (i/r)·b − c·v − d·sign(v))/m − μ·v'

State of a filter, as of `motion_filter`: position (m) and velocity (m/s) of roller 2; E and its rate over a reference
E; torque offset b of axis 2 (N·m, motor side), viscous c (N·s/m) and dry friction d (N) at the web, relative error μ of
the moving mass. The measured torque is the input, its noise the process noise; the encoder is the measurement. Joint
state and parameters: Boulter, IWEB 1999, with E, loss torque and strain.
"""

from __future__ import annotations

from math import inf, log, pi
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import Record, compiled
from hilbench.estimation.bank import BankArrays
from hilbench.estimation.motion_filter import COMMON, MOST_NUISANCES, NUISANCE, PARAMETER, advance

E = PARAMETER
#: Nuisance parameters, estimated in addition to E.
NUISANCES = OFFSET, VISCOUS, DRY, MASS = range(NUISANCE, NUISANCE + 4)
SIZE: Final = NUISANCE + len(NUISANCES)
#: Inputs of a step.
INPUTS: Final = np.dtype(
    [
        *COMMON,
        ("mass_kg", "f8"),
        ("force_N", "f8"),
        ("web_N", "f8"),  # tension at the reference E
        ("force_per_torque", "f8"),
        ("speed_m_s", "f8"),
        ("acceleration_m_s2", "f8"),  # smoothed, for the error of the mass
        ("force_variance", "f8"),
    ]
)
#: Time in which a nuisance parameter may wander through its prior: a working day. Were it faster, a slow change of
#: tension could not be separated from E.
_WANDER_S: Final = 36000.0


def new_inputs(priors: Array, mass_kg: float, force_per_torque: float) -> np.ndarray:
    """Inputs (1,) of a roller; `priors`: deviations of NUISANCES, 0 of one that is not estimated."""
    inputs = np.zeros(1, INPUTS)
    inputs["mass_kg"], inputs["force_per_torque"] = mass_kg, force_per_torque
    inputs["priors"], inputs["memories_s"] = [*priors, *[0.0] * (MOST_NUISANCES - len(priors))], _WANDER_S
    inputs["drift_s"] = inputs["parameter_bound"] = inf
    return inputs


@compiled
def step(b: BankArrays, u: Record) -> None:
    """Step all filters by one cycle; u: `INPUTS`. Their states are the first four and the estimated NUISANCES, the
    others are 0."""
    z, places, g, rows, count = b.z, b.places, b.work[SIZE + 3 :], b.work, b.z.shape[1]
    dt, mass, speed = u.duration_s, u.mass_kg, u.speed_m_s
    sign = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else 0.0)
    rate, noise, variance_N2 = rows[SIZE + 1], rows[SIZE + 2], u.force_variance
    own, by_e = u.force_N / mass, -u.web_N / mass
    by_nuisances = -u.force_per_torque / mass, -speed / mass, -sign / mass, -u.acceleration_m_s2
    for i in range(count):
        g[E, i], noise[i], rate[i] = by_e, variance_N2, own + by_e * z[E, i]
        g[OFFSET, i], g[VISCOUS, i], g[DRY, i], g[MASS, i] = by_nuisances
    for m in range(OFFSET, len(places)):
        j = places[m]
        for i in range(count):
            rate[i] += g[j, i] * z[j, i]
    advance(b, u, 0.5 * dt * dt / mass, dt / mass, dt)
    innovation, variance = rate, noise
    for i in range(count):
        b.likelihoods[i] = -0.5 * (innovation[i] * innovation[i] / variance[i] + log(2.0 * pi * variance[i]))
