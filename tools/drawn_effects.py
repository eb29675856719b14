"""Effects of drawn sizes for the scoreboards on independent lines."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

#: Sizes that are usual on this machine; a draw takes half of it to twice.
SINGLES: dict[str, dict[str, float]] = {
    "coulomb_friction": {"force_N": 4.0},
    "viscous_friction": {"coefficient_N_s_per_m": 2.0},
    "roller_eccentricity": {"amplitude_m": 2e-5, "phase_rad": 0.0},
    "torque_ripple": {"amplitude_Nm": 0.06, "order": 2.0, "phase_rad": 0.0},
    "torque_offset": {"offset_Nm": 0.05},
    "torque_scale": {"relative_change": 0.1},
    "inertia_mismatch": {"relative_change": 0.15},
    "elasticity_shift": {"relative_change": 0.1},
    "elasticity_step": {"time_s": 0.0, "relative_change": 0.1},
    "elasticity_drift": {"rate_per_s": 2e-3},
    "web_slip": {"creep_per_N": 2e-6},
    "upstream_disturbance": {"amplitude_N": 4.0, "frequency_Hz": 0.8, "phase_rad": 0.0},
}
_SIGNED = ("offset_Nm", "relative_change", "rate_per_s")


def drawn_values(usual: Mapping[str, float], rng: np.random.Generator, duration_s: float) -> dict[str, float]:
    """Parameters around those that are usual: sizes by chance, some with the other sign, phase, order and time anew."""
    values = {}
    for parameter, size in usual.items():
        value = size * float(np.exp(rng.uniform(-0.7, 0.7)))
        if parameter in _SIGNED and rng.random() < 0.5:
            value = -value
        if parameter == "phase_rad":
            value = float(rng.uniform(-3.0, 3.0))
        if parameter == "order":
            value = float(rng.choice([1.0, 2.0, 6.0]))
        if parameter == "time_s":
            value = float(rng.uniform(0.35, 0.8) * duration_s)
        values[parameter] = value
    return values
