"""Identifiability of E: the Cramér–Rao bound of a run's own samples.

Each sample of the measured torque of axis 2 is τ = (r/i)·E·h + noise, so it adds (h·r/i)²/σ² to the information
on E since its last change. The inverse of the information is the least variance that an unbiased estimate from these
samples can have.
"""

from __future__ import annotations

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters


def torque_noise_Nm(data: Measurements) -> float:
    """Standard deviation of the white noise on the measured torque of axis 2, over the whole recording."""
    level = NoiseLevel(0.0, 1e-6, memory=len(data.t_s))
    for torque in data.tau2_Nm:
        level.update(float(torque))
    return level.deviation


def least_deviation_Pa(model: ModelParameters, data: Measurements, start: int, noise_Nm: float) -> Array:
    """Bound of the standard deviation of E at each sample from `start` on, when E last changed there; (n - start,).
    Infinite while there is no information."""
    ratio, web = MeasuredBalance(model).force_per_torque_per_m, LineFollower(model)
    web.reset(data.x_m[0], [data.strain_prev[0]])
    boundary = np.column_stack([data.strain_prev, data.F_next_N])
    per_Pa = web.follow_rows(data.x_m, boundary, data.cycle_s)[start:, 0] / model.youngs_modulus_Pa(1) / ratio
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(np.cumsum((per_Pa / noise_Nm) ** 2)))
