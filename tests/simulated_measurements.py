"""Measurements of a simulated plant with a known E, as test data of synchronizers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.estimation.web_line.measurements import Measurements
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.offline import simulate, start_state
from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.float64]

#: Resolution of the encoders, rad at the motor: 20 bits a turn.
ENCODER_RAD = 2.0 * np.pi / 2**20


def simulated_measurements(
    plant: ModelParameters,
    v_cmd_m_s: Array,
    E_Pa: Array,
    *,
    cycle_s: float = 0.002,
    torque_noise_Nm: float = 0.05,
    torque_offset_Nm: float = 0.0,
    seed: int = 0,
) -> Measurements:
    """Simulate the closed model from rest on commands (n, 2) m/s, with E (n,) from each row on; axis 2 is measured.

    The upstream strain stays the model's. Equal arguments give equal measurements, bit for bit. Raises ValueError as
    `hilbench.plant.web_line.offline.simulate`.
    """
    n = len(E_Pa)
    boundary = np.tile([plant.upstream_strain, plant.boundary.downstream_tension_N], (n, 1))
    parameters = lay.pack(plant)
    state = start_state(parameters, plant, None)
    x_m, tau_Nm = np.empty((n, 2)), np.empty(n)
    changes = np.flatnonzero(np.diff(E_Pa)) + 1
    for start, end in zip(np.append(0, changes), np.append(changes, n), strict=True):
        lay.Layout.of(parameters).span_rows(parameters).modulus_Pa = E_Pa[start]
        part = simulate(parameters, state, v_cmd_m_s[start:end], boundary[start:end], cycle_s)
        x_m[start:end], tau_Nm[start:end], state = part.x_m, part.tau_Nm[:, 1], part.state
    counts = ENCODER_RAD / np.array([plant.motor_rad_per_m(axis) for axis in (1, 2)])
    noise = torque_noise_Nm * np.random.default_rng(seed).standard_normal(n)
    return Measurements(
        t_s=np.asarray(np.arange(n) * cycle_s, np.float64),
        v_cmd_m_s=v_cmd_m_s,
        x_m=np.round(x_m / counts) * counts,
        tau2_Nm=tau_Nm + torque_offset_Nm + noise,
        strain_prev=boundary[:, 0],
        F_next_N=boundary[:, 1],
    )
