"""A servo axis: one shaft, and a load motor that emulates a larger flywheel than the one that is there."""

from __future__ import annotations

from typing import Final

from hilbench.cli.new_bench.machine import NewBench

NEW: Final = NewBench(
    questions=(
        ("inertia that the motor turns in kg·m²", ("machine", "shaft", "inertia_kg_m2"), 0.047),
        ("dry friction in N·m", ("machine", "shaft", "coulomb_friction_Nm"), 0.2),
        ("viscous friction in N·m·s", ("machine", "shaft", "viscous_friction_Nm_s_per_rad"), 0.004),
        ("inertia of the motor's rotor in kg·m²", ("machine", "motor", "inertia_kg_m2"), 0.001),
        ("torque limit of a motor in N·m", ("machine", "drives", "torque_limit_Nm"), 9.0),
        ("inertia of the flywheel on the stand in kg·m²", ("hardware", "shaft", "inertia_kg_m2"), 0.0385),
        ("dry friction on the stand in N·m", ("hardware", "shaft", "coulomb_friction_Nm"), 0.05),
    ),
    given={
        ("machine", "kind"): "servo_axis",
        ("load_motors", "load", "shaft"): "shaft",
        ("machine", "drives", "velocity_kp_Nm_s_per_rad"): 1.5,
        ("machine", "drives", "velocity_ki_Nm_per_rad"): 30.0,
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
    virtual_io="hilbench_virtual_io_servo_axis.eds",
)
