"""A servo axis: one shaft, and a load motor that emulates a larger flywheel than the one that is there."""

from __future__ import annotations

from typing import Final

from hilbench.apps.commands.new_bench.machine import Answers, NewBench, rounded

_INERTIA, _MOTOR_INERTIA = ("machine", "shaft", "inertia_kg_m2"), ("machine", "motor", "inertia_kg_m2")
_FRICTION: Final = ("machine", "shaft", "coulomb_friction_Nm")
#: Of the example servo_axis, from which other sizes are scaled: what the motor turns, its rotor, kg·m².
_J, _J_motor = 0.047, 0.001


def _scaled(of_example: float, answers: Answers) -> float:
    """A torque limit or a gain with which the axis is as fast as the example."""
    return rounded(of_example * (answers(_INERTIA) + answers(_MOTOR_INERTIA)) / (_J + _J_motor))


NEW: Final = NewBench(
    questions=(
        ("inertia that the motor turns in kg·m²", _INERTIA, _J),
        ("dry friction in N·m", _FRICTION, 0.2),
        ("viscous friction in N·m·s", ("machine", "shaft", "viscous_friction_Nm_s_per_rad"), 0.004),
        ("inertia of the motor's rotor in kg·m²", _MOTOR_INERTIA, _J_motor),
        (
            "torque limit of a motor in N·m",
            ("machine", "drives", "torque_limit_Nm"),
            lambda answers: _scaled(9.0, answers),
        ),
        (
            "inertia of the flywheel on the stand in kg·m²",
            ("hardware", "shaft", "inertia_kg_m2"),
            lambda answers: rounded(0.0385 / _J * answers(_INERTIA)),
        ),
        (
            "dry friction on the stand in N·m",
            ("hardware", "shaft", "coulomb_friction_Nm"),
            lambda answers: rounded(0.25 * answers(_FRICTION)),
        ),
        ("speed in rad/s", ("steps", 0, "ramp", "to"), 20.0),
        ("largest error of the inertia at the end in %", ("criteria", 0, "max"), 2.0),
    ),
    given={
        ("machine", "kind"): "servo_axis",
        ("load_motors", "load", "shaft"): "shaft",
        ("machine", "drives", "current_loop_time_constant_s"): 0.001,
        ("steps",): [
            {"ramp": {"path": "speed_rad_s", "to": 20.0, "duration_s": 2.0}},
            {"hold": {"duration_s": 4.0}},
            {"ramp": {"path": "speed_rad_s", "to": 0.0, "duration_s": 2.0}},
        ],
        ("criteria",): [
            {"name": "inertia at the end", "metric": "J_final_error_pct", "max": 2.0, "unit": "%"},
            {"name": "no frame lost", "metric": "lost_frames", "max": 0.0},
        ],
    },
    nodes={
        ("drives", "shaft"): 1,
        ("load_motors", "load"): 3,
        ("drives", "shaft", "virtual"): 17,
        ("twin", "node"): 32,
    },
    follows={
        ("machine", "drives", "velocity_kp_Nm_s_per_rad"): lambda answers: _scaled(1.5, answers),
        ("machine", "drives", "velocity_ki_Nm_per_rad"): lambda answers: _scaled(30.0, answers),
    },
    virtual_io="hilbench_virtual_io_servo_axis.eds",
)
