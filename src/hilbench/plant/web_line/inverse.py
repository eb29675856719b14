"""Inverse dynamics of an axis: the torque its drive reports for a measured motion."""

from __future__ import annotations

from collections.abc import Callable

from hilbench.compiled import entry_point, inlined
from hilbench.plant.web_line import kernel, laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector

RequiredTorque = Callable[[Vector, Vector, Vector, Vector, float, Vector], None]


@inlined
def true_motion(p: Vector, motor: int, x_m: float, v_m_s: float, a_m_s2: float) -> tuple[float, float, float]:
    """Position, speed and acceleration at the web that were measured so."""
    if not laws.has_encoder_error(p, motor):
        return x_m, v_m_s, a_m_s2
    ratio = p[motor + lay.M_RAD_PER_M]
    x, v, a = laws.true_motion(p, motor, x_m * ratio, v_m_s * ratio, a_m_s2 * ratio)
    return x / ratio, v / ratio, a / ratio


@inlined
def reported_torque_Nm(
    p: Vector, axis: int, motor: int, x_m: float, v_m_s: float, a_m_s2: float, pull_N: float
) -> float:
    """Torque, motor side, that a drive reports (without its delay) for a motion of its axis; `pull_N` of the web."""
    ratio = p[motor + lay.M_RAD_PER_M]
    mass = (p[axis + lay.A_MOTOR_MASS_KG] + p[axis + lay.A_ROLLER_MASS_KG]) * laws.inertia_factor(p, axis)
    direction = laws.measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    passed = mass * a_m_s2 + laws.measured_resistance_N(p, axis, x_m, v_m_s, laws.FRICTION_WIDTH_M_S) - pull_N
    force = laws.pushed_with_N(p, axis, passed, direction)
    torque = laws.motor_torque_Nm(p, motor, force / ratio, x_m * ratio)
    fed_forward: float = laws.fed_forward_N(p, axis, motor, mass, v_m_s, a_m_s2, direction) / ratio
    return torque - fed_forward + laws.reported_offset_Nm(p, motor)


def _required_torque(sources: int) -> RequiredTorque:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point
    def required(p: Vector, x_m: Vector, v_m_s: Vector, a_m_s2: Vector, period_s: float, out_Nm: Vector) -> None:
        axis = lay.W_SIZE
        motor = lay.W_SIZE + int(p[lay.W_AXES]) * lay.A_SIZE
        late = laws.reporting_delay_s(p, motor) / period_s if sources >= 0 else 0.0
        for k in range(len(x_m)):
            at = min(max(k - late, 0.0), len(x_m) - 1.0)
            first = min(int(at), len(x_m) - 2)
            share = at - first
            x = x_m[first] + share * (x_m[first + 1] - x_m[first])
            v = v_m_s[first] + share * (v_m_s[first + 1] - v_m_s[first])
            a = a_m_s2[first] + share * (a_m_s2[first + 1] - a_m_s2[first])
            x, v, a = true_motion(p, motor, x, v, a)
            out_Nm[k] = reported_torque_Nm(p, axis, motor, x, v, a, 0.0)

    return required


#: required_torque_Nm(parameters (P,), x, v, a (n,) at the web, period_s, out (n,) N·m at the motor).
required_torque_Nm = _required_torque(kernel.source_number(__file__))
