"""Inverse dynamics of a lone axis: the torque its drive reports for a measured motion."""

from __future__ import annotations

from collections.abc import Callable

from hilbench.compiled import entry_point
from hilbench.plant.web_line import kernel, laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector

RequiredTorque = Callable[[Vector, Vector, Vector, Vector, float, Vector], None]


def _required_torque(sources: int) -> RequiredTorque:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point
    def required(p: Vector, x_m: Vector, v_m_s: Vector, a_m_s2: Vector, period_s: float, out_Nm: Vector) -> None:
        axis = lay.W_SIZE
        motor = lay.W_SIZE + int(p[lay.W_AXES]) * lay.A_SIZE
        ratio = p[motor + lay.M_RAD_PER_M]
        mass = (p[axis + lay.A_MOTOR_MASS_KG] + p[axis + lay.A_ROLLER_MASS_KG]) * laws.inertia_factor(p, axis)
        late = laws.reporting_delay_s(p, motor) / period_s if sources >= 0 else 0.0
        for k in range(len(x_m)):
            at = min(max(k - late, 0.0), len(x_m) - 1.0)
            first = min(int(at), len(x_m) - 2)
            share = at - first
            x = x_m[first] + share * (x_m[first + 1] - x_m[first])
            v = v_m_s[first] + share * (v_m_s[first + 1] - v_m_s[first])
            a = a_m_s2[first] + share * (a_m_s2[first + 1] - a_m_s2[first])
            if laws.has_encoder_error(p, motor):
                x, v, a = laws.true_motion(p, motor, x * ratio, v * ratio, a * ratio)
                x, v, a = x / ratio, v / ratio, a / ratio
            direction = laws.measured_direction(v, laws.FRICTION_WIDTH_M_S)
            passed = mass * a + laws.measured_resistance_N(p, axis, x, v, laws.FRICTION_WIDTH_M_S)
            force = laws.pushed_with_N(p, axis, passed, direction)
            torque = laws.motor_torque_Nm(p, motor, force / ratio, x * ratio)
            torque -= laws.fed_forward_N(p, axis, motor, mass, v, a, direction) / ratio
            out_Nm[k] = torque + laws.reported_offset_Nm(p, motor)

    return required


#: required_torque_Nm(parameters (P,), x, v, a (n,) at the web, period_s, out (n,) N·m at the motor).
required_torque_Nm = _required_torque(kernel.source_number(__file__))
