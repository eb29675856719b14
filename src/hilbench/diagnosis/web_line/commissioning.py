"""What a web line has of its own in a commissioning: of which effects something is told, and what is believed of them.

Of another machine it says nothing.
"""

from __future__ import annotations

from typing import Final

from hilbench.diagnosis.terms import Term
from hilbench.estimation.web_line.config import ModelErrorsConfig
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters

#: What is believed of an effect that `model_errors` has no word on: so many of its usual sizes.
WIDE: Final = 10.0
#: Share up to which radii are one.
_SAME_RADIUS: Final = 0.01


def has_own(term: Term, model: Machine) -> bool:
    """Whether there is something of its own to be told of it.

    What is of all spans is told of each. Rollers of one radius keep their angles to each other, so that the web shows
    how far each is out of true beyond the first: of that one nothing is told then.
    """
    if term.effect.per_section and term.section is None and model.span_count > 1:
        return False
    if term.effect.id != "roller_eccentricity" or term.axis != 1 or not isinstance(model, ModelParameters):
        return True
    radii_m = [model.radius_m(axis) for axis in range(1, model.axis_count + 1)]
    return max(radii_m) > (1.0 + _SAME_RADIUS) * min(radii_m)


def believed_sizes(term: Term, model: Machine, errors: ModelErrorsConfig, modulus_share: float) -> dict[str, float]:
    """Standard deviations of strengths at the axis of a term before anything is measured, by effect: as a twin believes
    them; of E `modulus_share`, relative."""
    if not isinstance(model, ModelParameters):
        return {}
    axis, boundary = term.axis or 1, model.boundary
    tension_N = max(boundary.upstream_tension_N, boundary.downstream_tension_N)
    strain = tension_N / model.stiffness_N(1)
    limit_Nm = per_item(model.drives.torque_limit_Nm, axis) if model.drives else WIDE * term.size
    friction_N = 0.01 * errors.friction_pct * tension_N
    return {
        "coulomb_friction": friction_N,
        "viscous_friction": friction_N / errors.at_speed_m_s,
        "torque_offset": 0.01 * errors.torque_offset_pct * limit_Nm,
        "strain_offset": 0.01 * errors.strain_pct * strain,
        "web_slip": 0.01 * errors.creep_pct / model.stiffness_N(1),
        "roller_eccentricity": 1e-6 * errors.eccentricity_um,
        "unbalance": 0.01 * errors.unbalance_pct * tension_N * model.radius_m(axis),
        "elasticity_shift": modulus_share,
    }
