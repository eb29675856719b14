"""Driving force of a roller by measured motion and torque: the motor's, less all resistance except web and inertia."""

from __future__ import annotations

from hilbench.compiled import Vector
from hilbench.plant.web_line import laws
from hilbench.plant.web_line.layout import Layout


def driving_force_N(p: Vector, axis: int, torque_Nm: float, x_m: float, v_m_s: float) -> float:
    """Driving force (i/r)·τ − R(v) of a roller, from 1, by the parameters of a line, effects included: at the web, N.

    `torque_Nm`: at the motor, as measured; `x_m`, `v_m_s`: position and speed of the roller at the web.
    """
    layout = Layout.of(p)
    row, motor = layout.axis_rows(p)[axis - 1], layout.motor_rows(p)[axis - 1]
    return float(laws.measured_drive_N(row, motor, torque_Nm, x_m, v_m_s))
