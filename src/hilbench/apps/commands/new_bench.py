"""Questions of `hilbench config new` and its answers, by kind of machine; the rest of a config is in `new_benches`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

#: A key of the config, from its root.
Place = tuple[str | int, ...]
#: Gives the answer at a place.
Answers = Callable[[Place], Any]
#: What is suggested: a value, or how it follows from the answers before.
Suggested = Any | Callable[[Answers], float]
#: Where a machine's drives are.
DRIVES: Final = ("machine", "drives")


#: A question, the place of its answer, what is suggested; without a question that is taken unasked.
Question = tuple[str, Place, Suggested]


def rounded(value: float) -> float:
    """Four digits: as many as the demonstrator's sizes have, from which others are scaled."""
    return float(f"{value:.4g}")


# -- a servo axis: one shaft, and a load motor that emulates a larger flywheel than the one that is there

_TURNED, _ROTOR = ("machine", "shaft", "inertia_kg_m2"), ("machine", "motor", "inertia_kg_m2")
_FRICTION: Final = ("machine", "shaft", "coulomb_friction_Nm")
#: Of the example servo_axis, from which other sizes are scaled: what the motor turns, its rotor, kg·m².
_J_TURNED, _J_ROTOR = 0.047, 0.001


def _scaled(of_example: float, answers: Answers) -> float:
    """A torque limit or a gain with which the axis is as fast as the example."""
    return rounded(of_example * (answers(_TURNED) + answers(_ROTOR)) / (_J_TURNED + _J_ROTOR))


SERVO_AXIS: Final[tuple[Question, ...]] = (
    ("inertia that the motor turns in kg·m²", _TURNED, _J_TURNED),
    ("dry friction in N·m", _FRICTION, 0.2),
    ("viscous friction in N·m·s", ("machine", "shaft", "viscous_friction_Nm_s_per_rad"), 0.004),
    ("inertia of the motor's rotor in kg·m²", _ROTOR, _J_ROTOR),
    ("torque limit of a motor in N·m", (*DRIVES, "torque_limit_Nm"), lambda answers: _scaled(9.0, answers)),
    (
        "inertia of the flywheel on the stand in kg·m²",
        ("hardware", "shaft", "inertia_kg_m2"),
        lambda answers: rounded(0.0385 / _J_TURNED * answers(_TURNED)),
    ),
    (
        "dry friction on the stand in N·m",
        ("hardware", "shaft", "coulomb_friction_Nm"),
        lambda answers: rounded(0.25 * answers(_FRICTION)),
    ),
    ("speed in rad/s", ("steps", 0, "ramp", "to"), 20.0),
    ("largest error of the inertia at the end in %", ("criteria", 0, "max"), 2.0),
    ("", (*DRIVES, "velocity_kp_Nm_s_per_rad"), lambda answers: _scaled(1.5, answers)),
    ("", (*DRIVES, "velocity_ki_Nm_per_rad"), lambda answers: _scaled(30.0, answers)),
)
