"""Effects of the vocabulary that a servo axis can have, and where."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from hilbench.plant import effects as vocabulary
from hilbench.plant.effect import Effect, EffectPlace, MachineKind
from hilbench.plant.effects import effects_of, find_effect
from hilbench.plant.parameters import EffectEntry

KIND = MachineKind.SERVO_AXIS
#: All of them; each has its law in `hilbench.plant.servo_axis.laws`. Torques are those at the motor shaft.
IDS = tuple(effect.id for effect in effects_of(KIND))


class ShaftEffect(EffectEntry):
    """Effect of a servo axis with its parameter values."""

    machine_kind: ClassVar[MachineKind] = KIND


def find(effect_id: str) -> Effect:
    """Effect of a servo axis by its id. Raises KeyError."""
    return find_effect(effect_id, KIND)


def effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Reason why a servo axis cannot have an effect, in one line, or None."""
    try:
        return find(effect_id).axis_problem(axis, 1)
    except KeyError as error:
        return str(error.args[0])


def emulated_effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Reason why a load motor cannot emulate an effect on the shaft, in one line, or None."""
    return vocabulary.effect_problem(effect_id, axis, EffectPlace.LOAD, 1, (1,), KIND)


def effects_problem(entries: Sequence[tuple[str, int | None]]) -> str | None:
    """Problem of the effects (id, axis) of a model, in one line, or None."""
    used: dict[str, int] = {}
    for position, (effect_id, axis) in enumerate(entries):
        problem = effect_problem(effect_id, axis)
        if problem is None:
            used[effect_id] = used.get(effect_id, 0) + 1
            slots = find(effect_id).slots
            if used[effect_id] > slots:
                problem = f"effect '{effect_id}' is given more than {slots} times"
        if problem:
            return f"entry {position + 1}: {problem}"
    return None
