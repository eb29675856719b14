"""Questions of `hilbench config new` for a web line, and its answers: the demonstrator, and what scales with it."""

from __future__ import annotations

from typing import Final

from hilbench.apps.commands.new_bench import DRIVES, Answers, Question, rounded

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


WEB_LINE: Final[tuple[Question, ...]] = (
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
    ("", (*DRIVES, "velocity_kp_Nm_s_per_rad"), lambda answers: _gain(_KP, answers)),
    ("", (*DRIVES, "velocity_ki_Nm_per_rad"), lambda answers: _gain(_KI, answers)),
)
