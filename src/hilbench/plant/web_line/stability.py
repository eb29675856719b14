"""How much a load motor can imitate over a sampled bus before the loop through it goes unstable.

Two laws of imitation, on the loop of `hilbench.plant.sampled_shaft`:

- inertia by torque, tau = -J_e·(v_k - v_{k-1})/T. Without any control loop the limit is J_e = J whatever the delay
  (the rates of change obey d_{k+1} = -(J_e/J)·d_{k-delay}); the axis' own loop moves it.
- the web as a spring, tau = -k·(x + lead·x'): the delay works as negative damping of about k·(delay - lead).
"""

from __future__ import annotations

import numpy as np

from hilbench.plant.parameters import per_item
from hilbench.plant.sampled_shaft import LinearLaw, SampledShaft, largest_stable, spectral_radius_under
from hilbench.plant.web_line.parameters import ModelParameters


def sampled_shaft(model: ModelParameters, axis: int = 2, **changes: float) -> SampledShaft:
    """The shaft of a model's axis. Raises ValueError for a model without drives."""
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


def spectral_radius(
    shaft: SampledShaft, *, inertia_kg_m2: float = 0.0, stiffness_Nm_per_rad: float = 0.0, lead_s: float = 0.0
) -> float:
    """Greatest magnitude of the loop's eigenvalues over one bus cycle while inertia or a spring is imitated."""
    return spectral_radius_under(shaft, _law(shaft, inertia_kg_m2, stiffness_Nm_per_rad, lead_s))


def largest_inertia_ratio(shaft: SampledShaft, most: float = 100.0) -> float:
    """Largest emulated over real inertia that is stable (at most `most`)."""
    return largest_stable(lambda ratio: spectral_radius(shaft, inertia_kg_m2=ratio * shaft.inertia_kg_m2), most)


def largest_stiffness_Nm_per_rad(shaft: SampledShaft, lead_s: float = 0.0, most: float = 1e6) -> float:
    """Largest spring at the shaft that is stable (at most `most`); a web's is E·S/L·(r/i)²."""
    return largest_stable(lambda k: spectral_radius(shaft, stiffness_Nm_per_rad=k, lead_s=lead_s), most)


def web_stiffness_Nm_per_rad(model: ModelParameters, axis: int = 2, modulus_Pa_per_m: float | None = None) -> float:
    """The span before `axis` as a spring at its motor: E·S/L·(r/i)²; `modulus_Pa_per_m`: E/L, unless the model's."""
    if modulus_Pa_per_m is None:
        modulus_Pa_per_m = model.youngs_modulus_Pa(axis - 1) / model.span_length_m(axis - 1)
    return modulus_Pa_per_m * model.section_m2(axis - 1) / model.motor_rad_per_m(axis) ** 2


def _law(shaft: SampledShaft, inertia: float, stiffness: float, lead_s: float) -> LinearLaw:
    """Both laws together; the memory is velocity and position of the SYNC before."""
    rate = 1.0 / shaft.cycle_s
    return LinearLaw(
        memory=np.zeros((2, 2)),
        motion=np.array([[0.0, 1.0], [1.0, 0.0]]),
        from_memory=np.array([inertia * rate, stiffness * lead_s * rate]),
        from_motion=np.array([-stiffness * (1.0 + lead_s * rate), -inertia * rate]),
    )
