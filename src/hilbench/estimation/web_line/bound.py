"""Identifiability of E: the Cramér–Rao bound of a run's own samples.

Each sample of the measured torque of axis 2 is τ = (r/i)·(E·h + …) + noise, so it adds (h·r/i)²/σ² to the information
on E since its last change; nuisance parameters add their own sensitivities. The inverse of the information is the least
variance that an unbiased estimate from these samples can have.
"""

from __future__ import annotations

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.estimation.web_line.config import AlsoEstimated
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters


def torque_noise_Nm(data: Measurements) -> float:
    """Standard deviation of the white noise on the measured torque of axis 2, over the whole recording."""
    level = NoiseLevel(0.0, 1e-6, memory=len(data.t_s))
    for torque in data.tau2_Nm:
        level.update(float(torque))
    return level.deviation


def least_deviation_Pa(
    model: ModelParameters, data: Measurements, start: int, noise_Nm: float, also: AlsoEstimated | None = None
) -> Array:
    """Bound of the standard deviation of E at each sample from `start` on, when E last changed there; (n - start,).

    Infinite while there is no information. `also`: nuisance parameters estimated in addition to E, with their prior
    deviations.
    """
    balance, web = MeasuredBalance(model), LineFollower(model)
    web.reset(data.x_m[0], [data.strain_prev[0]])
    boundary = np.column_stack([data.strain_prev, data.F_next_N])
    per_Pa = web.follow_rows(data.x_m, boundary, data.cycle_s)[:, 0] / model.youngs_modulus_Pa(1)
    ratio = balance.force_per_torque_per_m
    velocity = np.gradient(data.x_m[:, 1], data.t_s)[start:]
    acceleration = np.gradient(velocity, data.t_s[start:])
    # In the order of `AlsoEstimated`; forces at the web become torques at the motor by r/i.
    others = np.column_stack(
        [np.ones(len(velocity)), velocity / ratio, np.sign(velocity) / ratio, balance.mass_kg * acceleration / ratio]
    )
    priors = np.array([value for _, value in also or AlsoEstimated(inertia_share=0.0)])
    used = priors > 0.0
    rows = np.column_stack([per_Pa[start:] / ratio, others[:, used]]) / noise_Nm
    information = np.cumsum(rows[:, :, None] * rows[:, None, :], axis=0)
    information[:, 1:, 1:] += np.diag(1.0 / priors[used] ** 2)
    return _deviation_of_first(information)


def _deviation_of_first(information: Array) -> Array:
    """Square root of the first element of the inverse of each (k, k) matrix, by its Schur complement."""
    first = information[:, 0, 0].copy()
    if information.shape[1] > 1:
        cross = information[:, 0, 1:]
        first -= np.einsum("ni,ni->n", cross, np.linalg.solve(information[:, 1:, 1:], cross[:, :, None])[:, :, 0])
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(np.maximum(first, 0.0)))
