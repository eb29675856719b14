"""Inverse dynamics of a servo axis: the torque that its drive reports for a measured motion."""

from __future__ import annotations

import numpy as np

from hilbench.compiled import REAL, VECTOR, entry_point, inlined
from hilbench.plant.hysteresis import friction_direction, wound
from hilbench.plant.motor_laws import measured_direction, value_at
from hilbench.plant.servo_axis import laws
from hilbench.plant.servo_axis.layout import Vector

#: Speed within which the direction of a measured motion is uncertain, rad/s: dry friction is linear there.
DIRECTION_WIDTH_RAD_S = 1e-3


@inlined
def reported_torque_Nm(
    p: Vector, time_s: float, x: float, v: float, a: float, of_all: float, direction: float
) -> float:
    """Torque that the drive reports (without its delay) for a motion of the shaft at a time, rad, rad/s, rad/s².

    of_all: mean acceleration of all that turns, which differs from the motor's if a part of it is behind a twisting
    shaft; direction: of the dry friction, -1 to 1.
    """
    resistance = laws.smooth_friction_Nm(p, v) + direction * laws.dry_friction_Nm(p, v) - laws.unbalance_Nm(p, x)
    passed = laws.inertia_kg_m2(p, time_s) * of_all + resistance
    torque = laws.motor_torque_Nm(p, laws.turned_with_Nm(p, passed, direction), x)
    fed_forward: float = laws.fed_forward_Nm(p, time_s, v, a, direction) if laws.has_feed_forward(p) else 0.0
    return torque - fed_forward + laws.reported_offset_Nm(p)


@inlined
def _swung(p: Vector, swing: tuple[float, float], a_before: float, a: float, period_s: float) -> tuple[float, float]:
    """Twist and its rate a row later, the motor's acceleration linear between the two rows."""
    q, w = swing
    count = laws.swing_steps(p, period_s)
    h, slope = period_s / count, (a - a_before) / count
    for step in range(count):
        first = a_before + step * slope
        middle, last = first + 0.5 * slope, first + slope
        b1 = laws.acceleration_behind(p, q, w) - first
        w2 = w + 0.5 * h * b1
        b2 = laws.acceleration_behind(p, q + 0.5 * h * w, w2) - middle
        w3 = w + 0.5 * h * b2
        b3 = laws.acceleration_behind(p, q + 0.5 * h * w2, w3) - middle
        w4 = w + h * b3
        b4 = laws.acceleration_behind(p, q + h * w3, w4) - last
        q += h / 6.0 * (w + 2.0 * w2 + 2.0 * w3 + w4)
        w += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    return q, w


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR, REAL)
def _required_torque_Nm(
    p: Vector,
    x_rad: Vector,
    v_rad_s: Vector,
    a_rad_s2: Vector,
    period_s: float,
    out_Nm: Vector,
    presliding_rad: float,
) -> None:
    late = laws.reporting_delay_s(p) / period_s
    deflection, before = 0.0, x_rad[0]
    swing, a_before = (0.0, 0.0), 0.0
    for k in range(len(x_rad)):
        at = min(max(k - late, 0.0), len(x_rad) - 1.0)
        x, v, a = value_at(x_rad, at), value_at(v_rad_s, at), value_at(a_rad_s2, at)
        if laws.has_encoder_error(p):
            x, v, a = laws.true_motion(p, x, v, a)
        direction = measured_direction(v, DIRECTION_WIDTH_RAD_S)
        if presliding_rad > 0.0:
            deflection, before = wound(deflection, x - before, 0.0, presliding_rad), x
            direction = friction_direction(deflection, 0.0, presliding_rad)
        of_all = a
        if laws.twists(p):
            swing = _swung(p, swing, a_before, a, period_s) if k > 0 else (laws.twist_under(p, a), 0.0)
            a_before = a
            of_all = laws.mean_acceleration(p, a, laws.acceleration_behind(p, swing[0], swing[1]))
        out_Nm[k] = reported_torque_Nm(p, at * period_s, x, v, a, of_all, direction)


def required_torque_Nm(
    p: Vector,
    x_rad: Vector,
    v_rad_s: Vector,
    a_rad_s2: Vector,
    period_s: float,
    out_Nm: Vector,
    presliding_rad: float = 0.0,
) -> None:
    """Torque required for a motion: parameters (P,), x, v, a (n,) at the shaft, a row every `period_s`; into out (n,)
    N·m.

    presliding_rad: travel over which dry friction reverses; 0: with the sign of the speed.
    """
    x, v, a = (np.ascontiguousarray(column) for column in (x_rad, v_rad_s, a_rad_s2))
    _required_torque_Nm(p, x, v, a, period_s, out_Nm, presliding_rad)
