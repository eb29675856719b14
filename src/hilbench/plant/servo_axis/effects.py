"""Which of the vocabulary of effects a servo axis can have, and where."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.effects import Domain, Effect, find_effect

#: Effects with a law in `hilbench.plant.servo_axis.laws`. Of those whose row speaks of newtons and metres the numbers
#: are those at a lever of 1 m: force_N is N·m, speed_m_s is rad/s, at the motor shaft.
IDS = (
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "friction_asymmetry",
    "torque_ripple",
    "torque_offset",
    "torque_scale",
    "inertia_mismatch",
)
#: What a load motor can imitate: resistance of the shaft. The rest belongs to the drive and its motor.
_IMITATED = frozenset({Domain.ROLLER_RESISTANCE, Domain.INERTIA})


def find(effect_id: str) -> Effect:
    """The row of an effect of a servo axis. Raises KeyError."""
    return find_effect(effect_id)


def effects() -> tuple[Effect, ...]:
    """Their rows."""
    return tuple(find(effect_id) for effect_id in IDS)


def effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Why a servo axis cannot have an effect, in one line, or None."""
    try:
        effect = find(effect_id)
    except KeyError as error:
        return str(error.args[0])
    if effect_id not in IDS:
        return f"effect '{effect_id}' of a servo axis, expected one of {', '.join(IDS)}"
    return effect.axis_problem(axis, 1)


def imitated_effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Why a load motor cannot imitate an effect on the shaft, in one line, or None."""
    problem = effect_problem(effect_id, axis)
    if problem is None and find(effect_id).domain not in _IMITATED:
        return f"effect '{effect_id}' belongs to drive and motor, expected one of the shaft; it goes in 'hardware:'"
    return problem


def effects_problem(entries: Sequence[tuple[str, int | None]]) -> str | None:
    """What is wrong with the effects (id, axis) of a model, in one line, or None."""
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
