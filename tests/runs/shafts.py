"""A recording of a servo axis as its bench would leave it, with known answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.results.recording import Recording
from hilbench.topology.signals import signals_of, smallest_shapes

DT_S = 0.002
J0_kg_m2, COULOMB_Nm, STEP_S = 2e-3, 0.05, 8.0
#: How fast the estimate follows, and its standard deviation.
TAU_S, SD_kg_m2 = 0.5, 4e-6
#: The shaft swings about its speed all the time: without acceleration nobody sees an inertia.
SPEED_rad_s, SWING_rad_s, SWINGS_Hz = 60.0, 20.0, 1.0


def recorded_shaft(duration_s: float = 20.0, share: float = 0.25, seed: int = 1) -> Recording:
    """The emulated inertia steps by a share of its value at 8 s; the shaft follows its command to 0.1 rad/s."""
    t = DT_S * np.arange(round(duration_s / DT_S) + 1)
    noise = np.random.default_rng(seed)
    after = t >= STEP_S - DT_S / 2
    true = np.where(after, J0_kg_m2 * (1 + share), J0_kg_m2)
    estimate = np.where(after, J0_kg_m2 * (1 + share * (1 - np.exp(-(t - STEP_S) / TAU_S))), J0_kg_m2)
    running = np.clip(t / 2, 0, 1)
    command = running * (SPEED_rad_s + SWING_rad_s * np.sin(2 * np.pi * SWINGS_Hz * t))
    velocity = command + noise.normal(0, 0.1, len(t))
    torque = true * np.gradient(command, DT_S) + COULOMB_Nm + noise.normal(0, 0.01, len(t))
    simulated = estimate * np.gradient(command, DT_S) + COULOMB_Nm
    known = {
        "t_s": t,
        "v1_cmd_rad_s": command,
        "x1_rad": np.cumsum(velocity) * DT_S,
        "v1_rad_s": velocity,
        "tau1_Nm": torque,
        "tau1_sim_Nm": simulated,
        "tau1_residual_Nm": torque - simulated,
        "J_sim_kg_m2": estimate,
        "J_sd_kg_m2": np.full_like(t, SD_kg_m2),
        "J_true_kg_m2": true,
        "coulomb_sim_Nm": np.full_like(t, 1.02 * COULOMB_Nm),
        "coulomb_true_Nm": np.full_like(t, COULOMB_Nm),
    }
    channels: dict[str, NDArray[np.float64]] = {
        signal.name: known.get(signal.name, np.zeros_like(t))
        for signal in signals_of("servo_axis", smallest_shapes()["servo_axis"])
    }
    return Recording(channels)
