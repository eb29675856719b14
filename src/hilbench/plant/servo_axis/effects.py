"""Effects of the vocabulary that a servo axis can have, and where."""

from __future__ import annotations

from typing import ClassVar

from hilbench.plant import effects as vocabulary
from hilbench.plant.effect import Effect, EffectPlace, MachineKind
from hilbench.plant.effects import effects_of, find_effect
from hilbench.plant.parameters import EffectEntry

KIND = MachineKind.SERVO_AXIS
#: All of them; their laws are in `hilbench.plant.web_line.laws`. Torques are those at the motor shaft.
IDS = tuple(effect.id for effect in effects_of(KIND))


class ShaftEffect(EffectEntry):
    """Effect of a servo axis with its parameter values."""

    machine_kind: ClassVar[MachineKind] = KIND


def find(effect_id: str) -> Effect:
    """Effect of a servo axis by its id. Raises KeyError."""
    return find_effect(effect_id, KIND)


def emulated_effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Reason why a load motor cannot emulate an effect on the shaft, in one line, or None."""
    return vocabulary.effect_problem(effect_id, axis, EffectPlace.LOAD, 1, (1,), KIND)
