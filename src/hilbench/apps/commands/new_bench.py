"""Questions of `hilbench config new` and its answers, by kind of machine; the rest of a config is in `new_benches`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

#: A key of the config, from its root.
Place = tuple[str | int, ...]
#: Gives the answer at a place.
Answers = Callable[[Place], Any]
#: What is suggested: a value, or how it follows from the answers before.
Suggested = Any | Callable[[Answers], float]
#: Where a machine's drives are.
DRIVES: Final = ("machine", "drives")


@dataclass(frozen=True)
class NewBench:
    """A machine of one kind: simulated drives, and a first experiment that can be run."""

    questions: tuple[tuple[str, Place, Suggested], ...]  #: question, place of the answer, what is suggested
    follows: Mapping[Place, Callable[[Answers], float]] = field(default_factory=dict)  #: from the answers, unasked
    virtual_io: str = "hilbench_virtual_io.eds"  #: EDS file of the twin's virtual I/O


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


SERVO_AXIS: Final = NewBench(
    questions=(
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
    ),
    follows={
        (*DRIVES, "velocity_kp_Nm_s_per_rad"): lambda answers: _scaled(1.5, answers),
        (*DRIVES, "velocity_ki_Nm_per_rad"): lambda answers: _scaled(30.0, answers),
    },
    virtual_io="hilbench_virtual_io_servo_axis.eds",
)


_ROLLERS, _BOUNDARY = ("machine", "rollers"), ("machine", "boundary")
_WIDTH: Final = ("machine", "web", "width_m")
_RADIUS, _INERTIA, _GEAR = (*_ROLLERS, "radius_m"), (*_ROLLERS, "inertia_kg_m2"), (*_ROLLERS, "gear_ratio")
_MOTOR_INERTIA: Final = ("machine", "motors", "inertia_kg_m2")
_SPEED, _TENSION = ("steps", 0, "ramp", "to"), ("controllers", "tension_control", "set_point_N")
#: Of the first experiment, s: up to line speed.
_RAMP_S: Final = 4.0

# Sizes of the published demonstrator, from which those of other machines are scaled: of a roller radius and width in m,
# inertia in kg·m²; gear ratio; inertia in kg·m² and torque limit in N·m of a motor; line speed in m/s, tension in N.
_r, _b, _J, _i, _J_motor, _limit, _v, _F = 0.2, 0.5, 1.167, 5.0, 0.001, 9.0, 3.0, 80.0
#: Velocity loop of the demonstrator, N·m·s/rad and N·m/rad at its motor.
_KP, _KI = 1.5, 30.0


def _roller_inertia(answers: Answers) -> float:
    """Inertia of a tube with the wall of the demonstrator's, kg·m²: mass goes with radius and width, inertia with r² of
    it."""
    return rounded(_J * (answers(_RADIUS) / _r) ** 3 * answers(_WIDTH) / _b)


def _gear_ratio(answers: Answers) -> float:
    """Gear ratio with which the motor turns as fast at line speed as the demonstrator's."""
    return rounded(_i * (answers(_RADIUS) / _r) * (_v / max(1e-3, answers(_SPEED))))


def _at_motor(J: float, i: float, J_motor: float) -> float:
    return J / i**2 + J_motor


def _inertia_at_motor(answers: Answers) -> float:
    return _at_motor(answers(_INERTIA), answers(_GEAR), answers(_MOTOR_INERTIA))


def _torque(F: float, r: float, i: float, J_at_motor: float, v: float) -> float:
    """Torque at the motor, N·m: all of the tension, and the ramp."""
    return F * r / i + J_at_motor * (i / r) * v / _RAMP_S


def _torque_limit(answers: Answers) -> float:
    """Torque limit with the demonstrator's reserve, N·m."""
    radius, gear, speed = answers(_RADIUS), answers(_GEAR), answers(_SPEED)
    asked = _torque(answers(_TENSION), radius, gear, _inertia_at_motor(answers), speed)
    return rounded(_limit * asked / _torque(_F, _r, _i, _at_motor(_J, _i, _J_motor), _v))


def _gain(of_demonstrator: float, answers: Answers) -> float:
    """A gain of the velocity loop with which it is as fast as the demonstrator's."""
    return rounded(of_demonstrator * _inertia_at_motor(answers) / _at_motor(_J, _i, _J_motor))


WEB_LINE: Final = NewBench(
    questions=(
        ("Young's modulus of the web in Pa", ("machine", "web", "youngs_modulus_Pa"), 8.7e9),
        ("width of the web in m", _WIDTH, _b),
        ("thickness of the web in m", ("machine", "web", "thickness_m"), 65e-6),
        ("length of the span in m", ("machine", "web", "span_length_m"), 1.0),
        ("line speed in m/s", _SPEED, _v),
        ("set-point of the web tension in N", _TENSION, _F),
        ("radius of the rollers in m", _RADIUS, _r),
        ("inertia of a roller in kg·m²", _INERTIA, _roller_inertia),
        ("gear ratio, motor to roller", _GEAR, _gear_ratio),
        ("inertia of a motor in kg·m²", _MOTOR_INERTIA, _J_motor),
        ("torque limit of a motor in N·m", (*DRIVES, "torque_limit_Nm"), _torque_limit),
        ("web tension upstream in N", (*_BOUNDARY, "upstream_tension_N"), lambda answers: answers(_TENSION)),
        (
            "web tension downstream in N",
            (*_BOUNDARY, "downstream_tension_N"),
            lambda answers: 0.875 * answers(_TENSION),
        ),
        ("largest error of E at the end in %", ("criteria", 0, "max"), 2.0),
        ("largest error of the true tension at the end in N", ("criteria", 1, "max"), 2.0),
    ),
    follows={
        (*DRIVES, "velocity_kp_Nm_s_per_rad"): lambda answers: _gain(_KP, answers),
        (*DRIVES, "velocity_ki_Nm_per_rad"): lambda answers: _gain(_KI, answers),
    },
)
