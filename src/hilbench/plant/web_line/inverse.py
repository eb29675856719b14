"""Inverse dynamics of an axis: the torque its drive reports for a measured motion."""

from __future__ import annotations

from math import pi

import numpy as np

from hilbench.compiled import REAL, VECTOR, Record, Vector, entry_point, inlined
from hilbench.plant import motor_laws as motors
from hilbench.plant.hysteresis import LEAST_PRESLIDING, friction_direction, wound
from hilbench.plant.motor_laws import value_at
from hilbench.plant.web_line import laws, records
from hilbench.plant.web_line.records import LineArrays


@inlined
def true_motion(motor: Record, x_m: float, v_m_s: float, a_m_s2: float) -> tuple[float, float, float]:
    """True position, speed and acceleration at the web for measured ones."""
    error, ratio = motor.encoder_error, motor.rad_per_m
    if error.amplitude_rad == 0.0:
        return x_m, v_m_s, a_m_s2
    measured = x_m * ratio, v_m_s * ratio, a_m_s2 * ratio
    x, v, a = motors.true_motion(error.amplitude_rad, error.phase_rad, *measured)
    return x / ratio, v / ratio, a / ratio


@inlined
def reported_torque_Nm(
    line: LineArrays, i: int, t_s: float, motion: tuple[float, float, float], of_all_m_s2: float, pull_N: float,
    direction: float, carried: float,
) -> float:  # fmt: skip
    """Torque, motor side, that a drive reports (without its delay) for a motion (x, v, a) of axis i; `pull_N` of the
    web.

    of_all_m_s2: mean acceleration of all that turns, which is another than the motor's where a part of it is behind a
    twisting shaft; direction: of the dry friction, -1 to 1; carried: share of the roller that moves along, 0 within a
    play of the gear.
    """
    axis, motor, (x, v, a) = records.axis(line, i), records.motor(line, i), motion
    ratio, factor = motor.rad_per_m, laws.inertia_factor_at(axis, t_s, records.web(line).sample_time_s)
    mass = (axis.motor_mass_kg + carried * axis.roller_mass_kg) * factor
    resistance = 0.0
    if carried > 0.0:
        resistance = carried * laws.measured_resistance_N(axis, x, v, direction / carried)
    passed = mass * of_all_m_s2 + resistance - pull_N
    # Before load-dependent friction: the inverse of `laws.passed_on_N`.
    force = passed / (1.0 - (1.0 if passed > 0.0 else -1.0) * direction * axis.load_dependent_friction.share)
    # The drive's torque for this one on the shaft: the inverse of `laws.shaft_torque_Nm`.
    torque = (force / ratio - laws.ripple_Nm(motor, x * ratio)) / (1.0 + motor.torque_scale.relative_change)
    torque /= laws.load_ripple_factor(motor, x * ratio)
    fed_forward = laws.fed_forward_N(axis, motor, mass, v, a, direction) / ratio
    return float(torque - fed_forward + motor.torque_offset.offset_Nm)


@inlined
def _turned(axis: Record, twist: tuple[float, float], before: float, a: float, period_s: float) -> tuple[float, float]:
    """Twist of a shaft and its rate a row later, the motor's acceleration linear between the two rows."""
    q, w = twist
    count = laws.resonance_steps(axis, period_s)
    h, slope = period_s / count, (a - before) / count
    for step in range(count):
        first = before + step * slope
        middle, last = first + 0.5 * slope, first + slope
        b1 = laws.acceleration_behind(axis, q, w) - first
        w2 = w + 0.5 * h * b1
        b2 = laws.acceleration_behind(axis, q + 0.5 * h * w, w2) - middle
        w3 = w + 0.5 * h * b2
        b3 = laws.acceleration_behind(axis, q + 0.5 * h * w2, w3) - middle
        w4 = w + h * b3
        b4 = laws.acceleration_behind(axis, q + h * w3, w4) - last
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
    line = records.of_parameters(p)
    axis, motor = records.axis(line, 0), records.motor(line, 0)
    late, half_play = motor.torque_delay.delay_s / period_s, 0.5 * axis.backlash.gap_rad / motor.rad_per_m
    turns_over = presliding_m > 0.0 or half_play > 0.0
    presliding, deflection, before = max(presliding_m, LEAST_PRESLIDING), 0.0, x_m[0]
    twist, a_before = (0.0, 0.0), 0.0
    for k in range(len(x_m)):
        at = min(max(k - late, 0.0), len(x_m) - 1.0)
        motion = true_motion(motor, value_at(x_m, at), value_at(v_m_s, at), value_at(a_m_s2, at))
        x, v, a = motion
        carried = 1.0
        if turns_over:
            deflection, before = wound(deflection, x - before, half_play, presliding), x
            direction = friction_direction(deflection, half_play, presliding)
            if half_play > 0.0:
                carried = abs(direction)
        else:
            direction = motors.measured_direction(v, laws.FRICTION_WIDTH_M_S)
        of_all = a
        if axis.resonance.inertia_share != 0.0:
            if k == 0:  # under steady acceleration
                twist = -a / (2.0 * pi * axis.resonance.frequency_Hz) ** 2, 0.0
            else:
                twist = _turned(axis, twist, a_before, a, period_s)
            a_before = a
            of_all += axis.resonance.inertia_share * (laws.acceleration_behind(axis, twist[0], twist[1]) - a)
        out_Nm[k] = reported_torque_Nm(line, 0, at * period_s, motion, of_all, 0.0, direction, carried)


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
