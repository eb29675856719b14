"""Driving force of a roller by measured motion and torque: the motor's, less all resistance except web and inertia."""

from __future__ import annotations

from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector


def driving_force_N(p: Vector, axis: int, torque_Nm: float, x_m: float, v_m_s: float) -> float:
    """Driving force (i/r)·τ − R(v) of a roller, from 1, by the parameters of a line, effects included: at the web, N.

    `torque_Nm`: at the motor, as measured; `x_m`, `v_m_s`: position and speed of the roller at the web.
    """
    at = lay.W_SIZE + (axis - 1) * lay.A_SIZE
    motor = lay.W_SIZE + Layout.of(p).axes * lay.A_SIZE + (axis - 1) * lay.M_SIZE
    per_m = p.item(motor + lay.M_RAD_PER_M)
    true_Nm = laws.true_torque_Nm(p, motor, torque_Nm)
    drive_Nm = laws.shaft_torque_Nm(p, motor, true_Nm, x_m * per_m)
    direction = measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    resistance_N = laws.measured_resistance_N(p, at, x_m, v_m_s, direction)
    return float(laws.passed_on_N(p, at, per_m * drive_Nm, direction) - resistance_N)
