"""Which excitation would show an effect, or tell two apart."""

from __future__ import annotations

from typing import Final

from hilbench.plant.effects import find_effect

#: What shows an effect best.
SHOWN_BY: Final[dict[str, str]] = {
    "coulomb_friction": "stop, start and reverse the axis",
    "viscous_friction": "hold several line speeds",
    "stribeck_friction": "creep at 1 to 20 % of the highest speed",
    "roller_eccentricity": "hold a speed for many turns of the roller",
    "friction_asymmetry": "run the same speeds in both directions",
    "torque_ripple": "ramp the speed slowly through many motor turns",
    "torque_offset": "hold two tensions that are well apart",
    "torque_scale": "ramp the speed steeply and hold two tensions",
    "torque_delay": "ramp the speed steeply",
    "inertia_mismatch": "ramp the speed steeply",
    "backlash": "let the torque change its sign: brake, reverse",
    "elasticity_shift": "step the tension",
    "elasticity_step": "record longer before and after the change",
    "elasticity_ramp": "record longer before and after the change",
    "elasticity_drift": "record longer at constant conditions",
    "web_damping": "step the speed difference quickly",
    "web_slip": "hold several tensions at several line speeds",
    "strain_offset": "let E change, or load axis 1 with the web",
    "upstream_disturbance": "record longer at constant speed, then at another speed",
    "span_length_error": "step the speed difference at several line speeds",
}

#: What a step of E is like that the vocabulary has not: a force on roller 2 that sets in at a time.
FORCE_STEP: Final = "a step of a force at roller 2 (friction, downstream tension)"
_FORCE_STEP_TOLD_BY: Final = "step the tension after the change, and reverse"


def shown_by(effect_id: str) -> str:
    """The excitation for one effect. Raises KeyError for an unknown id."""
    return SHOWN_BY[find_effect(effect_id).id]


def told_apart_by(first: str, second: str) -> str:
    """The excitation that separates two effects that a recording can't tell apart."""
    if second == FORCE_STEP:
        return _FORCE_STEP_TOLD_BY
    one, other = shown_by(first), shown_by(second)
    return one if one == other else f"{one}; {other}"
