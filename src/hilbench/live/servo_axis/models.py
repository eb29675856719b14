"""Models of a servo axis with another inertia, or without what the twin estimates."""

from __future__ import annotations

from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import look

#: Effects that are a change of the inertia.
_OF_INERTIA = ("inertia_mismatch", "inertia_step")


def shaft(model: Machine) -> ServoAxisParameters:
    """Narrow a machine's type to a servo axis."""
    assert isinstance(model, ServoAxisParameters), "a servo axis is diagnosed as one"
    return model


def is_of_estimate(effect_id: str) -> bool:
    """True if an effect is a change of the inertia, which the twin estimates anyway."""
    return effect_id in _OF_INERTIA


def inertia_factor(model: ServoAxisParameters, time_s: float) -> float:
    """Factor of a model's effects on its inertia at a time of theirs."""
    return float(look(lay.pack(model), time_s)[0])


def with_inertia(model: ServoAxisParameters, inertia_kg_m2: float) -> ServoAxisParameters:
    """Model with this inertia, its effects included: the shaft has what exceeds the motor's rotor."""
    behind = max(inertia_kg_m2 / inertia_factor(model, 0.0) - model.motor.inertia_kg_m2, 0.0)
    return model.model_copy(update={"shaft": model.shaft.model_copy(update={"inertia_kg_m2": behind})})


def without_estimate(model: ServoAxisParameters, configured: ServoAxisParameters) -> ServoAxisParameters:
    """The model with the inertia that it was configured with."""
    entries = [entry for entry in model.effects if not is_of_estimate(entry.effect)]
    own = [entry for entry in configured.effects if is_of_estimate(entry.effect)]
    return configured.model_copy(update={"effects": (*own, *entries)})
