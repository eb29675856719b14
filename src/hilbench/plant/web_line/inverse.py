"""Inverse dynamics of an axis: the torque its drive reports for a measured motion."""

from __future__ import annotations

import numpy as np

from hilbench.compiled import REAL, VECTOR, entry_point, inlined
from hilbench.plant.hysteresis import LEAST_PRESLIDING, friction_direction, wound
from hilbench.plant.motor_laws import measured_direction, value_at
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


@inlined
def true_motion(p: Vector, motor: int, x_m: float, v_m_s: float, a_m_s2: float) -> tuple[float, float, float]:
    """True position, speed and acceleration at the web for measured ones."""
    if not laws.has_encoder_error(p, motor):
        return x_m, v_m_s, a_m_s2
    ratio = p[motor + lay.M_RAD_PER_M]
    x, v, a = laws.true_motion(p, motor, x_m * ratio, v_m_s * ratio, a_m_s2 * ratio)
    return x / ratio, v / ratio, a / ratio


@inlined
def reported_torque_Nm(
    p: Vector,
    axis: int,
    motor: int,
    t_s: float,
    x_m: float,
    v_m_s: float,
    a_m_s2: float,
    of_all_m_s2: float,
    pull_N: float,
    direction: float,
    carried: float,
) -> float:
    """Torque, motor side, that a drive reports (without its delay) for a motion of its axis; `pull_N` of the web.

    of_all_m_s2: mean acceleration of all that turns, which is another than the motor's where a part of it is behind a
    twisting shaft; direction: of the dry friction, -1 to 1; carried: share of the roller that moves along, 0 within a
    play of the gear.
    """
    ratio, factor = p[motor + lay.M_RAD_PER_M], laws.inertia_factor_at(p, axis, t_s)
    mass = (p[axis + lay.A_MOTOR_MASS_KG] + carried * p[axis + lay.A_ROLLER_MASS_KG]) * factor
    resistance = 0.0
    if carried > 0.0:
        resistance = carried * laws.measured_resistance_N(p, axis, x_m, v_m_s, direction / carried)
    passed = mass * of_all_m_s2 + resistance - pull_N
    force = laws.pushed_with_N(p, axis, passed, direction)
    torque = laws.motor_torque_Nm(p, motor, force / ratio, x_m * ratio)
    fed_forward: float = laws.fed_forward_N(p, axis, motor, mass, v_m_s, a_m_s2, direction) / ratio
    return torque - fed_forward + laws.reported_offset_Nm(p, motor)


@inlined
def _swung(
    p: Vector, axis: int, swing: tuple[float, float], a_before: float, a: float, period_s: float
) -> tuple[float, float]:
    """Twist of a shaft and its rate a row later, the motor's acceleration linear between the two rows."""
    q, w = swing
    count = laws.swing_steps(p, axis, period_s)
    h, slope = period_s / count, (a - a_before) / count
    for step in range(count):
        first = a_before + step * slope
        middle, last = first + 0.5 * slope, first + slope
        b1 = laws.acceleration_behind(p, axis, q, w) - first
        w2 = w + 0.5 * h * b1
        b2 = laws.acceleration_behind(p, axis, q + 0.5 * h * w, w2) - middle
        w3 = w + 0.5 * h * b2
        b3 = laws.acceleration_behind(p, axis, q + 0.5 * h * w2, w3) - middle
        w4 = w + h * b3
        b4 = laws.acceleration_behind(p, axis, q + h * w3, w4) - last
        q += h / 6.0 * (w + 2.0 * w2 + 2.0 * w3 + w4)
        w += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    return q, w


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR, REAL)
def _required_torque_Nm(
    p: Vector,
    x_m: Vector,
    v_m_s: Vector,
    a_m_s2: Vector,
    period_s: float,
    out_Nm: Vector,
    presliding_m: float,
) -> None:
    axis = lay.W_SIZE
    motor = lay.W_SIZE + int(p[lay.W_AXES]) * lay.A_SIZE
    late = laws.reporting_delay_s(p, motor) / period_s
    half_play = laws.half_gap_m(p, axis, p[motor + lay.M_RAD_PER_M])
    turns_over = presliding_m > 0.0 or half_play > 0.0
    presliding, deflection, before = max(presliding_m, LEAST_PRESLIDING), 0.0, x_m[0]
    swing, a_before = (0.0, 0.0), 0.0
    for k in range(len(x_m)):
        at = min(max(k - late, 0.0), len(x_m) - 1.0)
        x, v, a = true_motion(p, motor, value_at(x_m, at), value_at(v_m_s, at), value_at(a_m_s2, at))
        carried = 1.0
        if turns_over:
            deflection, before = wound(deflection, x - before, half_play, presliding), x
            direction = friction_direction(deflection, half_play, presliding)
            if half_play > 0.0:
                carried = abs(direction)
        else:
            direction = measured_direction(v, laws.FRICTION_WIDTH_M_S)
        of_all = a
        if laws.twists(p, axis):
            swing = _swung(p, axis, swing, a_before, a, period_s) if k > 0 else (laws.twist_under(p, axis, a), 0.0)
            a_before = a
            of_all += laws.share_behind(p, axis) * (laws.acceleration_behind(p, axis, swing[0], swing[1]) - a)
        out_Nm[k] = reported_torque_Nm(p, axis, motor, at * period_s, x, v, a, of_all, 0.0, direction, carried)


def required_torque_Nm(
    p: Vector,
    x_m: Vector,
    v_m_s: Vector,
    a_m_s2: Vector,
    period_s: float,
    out_Nm: Vector,
    presliding_m: float = 0.0,
) -> None:
    """Torque required for a motion: parameters (P,), x, v, a (n,) at the web, a row every `period_s`; into out (n,) N·m
    at the motor.

    presliding_m: travel over which dry friction reverses; 0: with the sign of the speed.
    """
    x, v, a = (np.ascontiguousarray(column) for column in (x_m, v_m_s, a_m_s2))
    _required_torque_Nm(p, x, v, a, period_s, out_Nm, presliding_m)
