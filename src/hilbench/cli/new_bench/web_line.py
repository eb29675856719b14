"""A web line: the demonstrator."""

from __future__ import annotations

from typing import Final

from hilbench.cli.new_bench.machine import NewBench

NEW: Final = NewBench(
    questions=(
        ("Young's modulus of the web in Pa", ("machine", "web", "youngs_modulus_Pa"), 8.7e9),
        ("width of the web in m", ("machine", "web", "width_m"), 0.5),
        ("thickness of the web in m", ("machine", "web", "thickness_m"), 65e-6),
        ("length of the span in m", ("machine", "web", "span_length_m"), 1.0),
        ("radius of the rollers in m", ("machine", "rollers", "radius_m"), 0.2),
        ("inertia of a roller in kg·m²", ("machine", "rollers", "inertia_kg_m2"), 1.167),
        ("gear ratio, motor to roller", ("machine", "rollers", "gear_ratio"), 5.0),
        ("inertia of a motor in kg·m²", ("machine", "motors", "inertia_kg_m2"), 0.001),
        ("torque limit of a motor in N·m", ("machine", "drives", "torque_limit_Nm"), 9.0),
        ("web tension upstream in N", ("machine", "boundary", "upstream_tension_N"), 80.0),
        ("web tension downstream in N", ("machine", "boundary", "downstream_tension_N"), 70.0),
        ("set-point of the web tension in N", ("controllers", "tension_control", "set_point_N"), 80.0),
    ),
    given={
        ("load_motors", "load", "shaft"): "axis2",
        ("machine", "web_load"): [False, True],
        ("machine", "drives", "velocity_kp_Nm_s_per_rad"): 1.5,
        ("machine", "drives", "velocity_ki_Nm_per_rad"): 30.0,
        ("machine", "drives", "current_loop_time_constant_s"): 0.001,
        ("steps",): [
            {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 4.0}},
            {"hold": {"duration_s": 6.0}},
            {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 4.0}},
        ],
        ("criteria",): [
            {"name": "E at the end", "metric": "E_final_error_pct", "max": 2.0, "unit": "%"},
            {"name": "true tension at its set-point", "metric": "tension_final_error_N", "max": 2.0, "unit": "N"},
            {"name": "no frame lost", "metric": "lost_frames", "max": 0.0},
        ],
    },
    nodes={
        ("drives", "axis1"): 1,
        ("drives", "axis2"): 2,
        ("load_motors", "load"): 3,
        ("drives", "axis1", "virtual"): 17,
        ("drives", "axis2", "virtual"): 18,
        ("twin", "node"): 32,
    },
)
