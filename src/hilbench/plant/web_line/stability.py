"""Stability limit of web emulation over a sampled bus: the stiffest web that a load motor can emulate.

The web is a spring at the shaft, tau = -k·(x + lead·x'), on the loop of `hilbench.plant.sampled_shaft`: the dead time
works as negative damping of about k·(delay - lead).
"""

from __future__ import annotations

import numpy as np

from hilbench.plant.parameters import per_item
from hilbench.plant.sampled_shaft import LinearLaw, SampledShaft, largest_stable, spectral_radius_under
from hilbench.plant.web_line.parameters import ModelParameters


def sampled_shaft(model: ModelParameters, axis: int = 2, **changes: float) -> SampledShaft:
    """Shaft of a model's axis. Raises ValueError for a model without drives."""
    if model.drives is None:
        raise ValueError("the model has no drives, expected 'drives'")
    values: dict[str, float] = {
        "inertia_kg_m2": model.mass_kg(axis) / model.motor_rad_per_m(axis) ** 2,
        "velocity_kp_Nm_s_per_rad": per_item(model.drives.velocity_kp_Nm_s_per_rad, axis),
        "velocity_ki_Nm_per_rad": per_item(model.drives.velocity_ki_Nm_per_rad, axis),
        "current_loop_time_constant_s": per_item(model.drives.current_loop_time_constant_s, axis),
        "sample_time_s": model.drives.sample_time_s,
    }
    return SampledShaft(**{**values, **changes})  # type: ignore[arg-type]


def spectral_radius(shaft: SampledShaft, stiffness_Nm_per_rad: float, lead_s: float = 0.0) -> float:
    """Greatest magnitude of the loop's eigenvalues over one bus cycle while a spring is emulated."""
    return spectral_radius_under(shaft, _spring(shaft, stiffness_Nm_per_rad, lead_s))


def largest_stiffness_Nm_per_rad(shaft: SampledShaft, lead_s: float = 0.0) -> float:
    """Largest spring at the shaft that is stable (at most 1e6); a web's is E·S/L·(r/i)²."""
    return largest_stable(lambda k: spectral_radius(shaft, k, lead_s), 1e6)


def _spring(shaft: SampledShaft, stiffness: float, lead_s: float) -> LinearLaw:
    """Linear law of a spring; its memory is the position of the previous SYNC."""
    rate = 1.0 / shaft.cycle_s
    return LinearLaw(
        memory=np.zeros((1, 1)),
        motion=np.array([[1.0, 0.0]]),
        from_memory=np.array([stiffness * lead_s * rate]),
        from_motion=np.array([-stiffness * (1.0 + lead_s * rate), 0.0]),
    )
