"""Inverse dynamics of a servo axis: the torque that its drive reports for a measured motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hilbench.compiled import REAL, VECTOR, entry_point, inlined
from hilbench.plant import hysteresis
from hilbench.plant.hysteresis import friction_direction, wound
from hilbench.plant.motor_laws import measured_direction, value_at
from hilbench.plant.servo_axis import kernel, laws
from hilbench.plant.servo_axis.layout import Vector

RequiredTorque = Callable[[Vector, Vector, Vector, Vector, float, Vector, float], None]

#: Speed within which the direction of a measured motion is not certain, rad/s: dry friction turns over linearly there.
DIRECTION_WIDTH_RAD_S = 1e-3


@inlined
def reported_torque_Nm(p: Vector, time_s: float, x: float, v: float, a: float, direction: float) -> float:
    """Torque that the drive reports (without its delay) for a motion of the shaft at a time, rad, rad/s, rad/s².

    direction: of the dry friction, -1 to 1.
    """
    resistance = laws.smooth_friction_Nm(p, v) + direction * laws.dry_friction_Nm(p, v) - laws.unbalance_Nm(p, x)
    passed = laws.inertia_kg_m2(p, time_s) * a + resistance
    torque = laws.motor_torque_Nm(p, laws.turned_with_Nm(p, passed, direction), x)
    fed_forward: float = laws.fed_forward_Nm(p, time_s, v, a, direction) if laws.has_feed_forward(p) else 0.0
    return torque - fed_forward + laws.reported_offset_Nm(p)


def _required_torque(sources: int) -> RequiredTorque:
    """The function that is called from Python; `sources` as in the kernel."""

    @entry_point(VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR, REAL)
    def required(
        p: Vector,
        x_rad: Vector,
        v_rad_s: Vector,
        a_rad_s2: Vector,
        period_s: float,
        out_Nm: Vector,
        presliding_rad: float,
    ) -> None:
        late = laws.reporting_delay_s(p) / period_s if sources >= 0 else 0.0
        deflection, before = 0.0, x_rad[0]
        for k in range(len(x_rad)):
            at = min(max(k - late, 0.0), len(x_rad) - 1.0)
            x, v, a = value_at(x_rad, at), value_at(v_rad_s, at), value_at(a_rad_s2, at)
            if laws.has_encoder_error(p):
                x, v, a = laws.true_motion(p, x, v, a)
            direction = measured_direction(v, DIRECTION_WIDTH_RAD_S)
            if presliding_rad > 0.0:
                deflection, before = wound(deflection, x - before, 0.0, presliding_rad), x
                direction = friction_direction(deflection, 0.0, presliding_rad)
            out_Nm[k] = reported_torque_Nm(p, at * period_s, x, v, a, direction)

    return required


_required_torque_Nm = _required_torque(kernel.source_number(__file__, hysteresis.__file__))


def required_torque_Nm(
    p: Vector,
    x_rad: Vector,
    v_rad_s: Vector,
    a_rad_s2: Vector,
    period_s: float,
    out_Nm: Vector,
    presliding_rad: float = 0.0,
) -> None:
    """Parameters (P,), x, v, a (n,) at the shaft, a row every `period_s`; into out (n,) N·m.

    presliding_rad: way over which dry friction turns over after a reversal; 0: with the sign of the speed.
    """
    x, v, a = (np.ascontiguousarray(column) for column in (x_rad, v_rad_s, a_rad_s2))
    _required_torque_Nm(p, x, v, a, period_s, out_Nm, presliding_rad)
