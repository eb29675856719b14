"""Law of a load motor that makes a shaft behave like another one, compiled.

    τ_load = −(J_i − J_r)·a − R_i(v) + R_r(v) + U_i(φ) − U_r(φ)

makes a shaft of inertia J_r, friction R_r and unbalance U_r behave like one of J_i, R_i and U_i. The torque acts later
than the motion was measured, so position, speed and acceleration are predicted over that lead, from an observer of
constant jerk. A shaft is one axis without a span (`hilbench.plant.servo_axis.layout`).
"""

from __future__ import annotations

from typing import Annotated, Any, Final, NamedTuple

from hilbench.arrays import Matrix
from hilbench.compiled import MATRIX, REAL, VECTOR, Reals, Reals2, Vector, compiled, entry_point, inlined, record_type
from hilbench.plant.web_line import kernel, laws, records
from hilbench.plant.web_line.records import LineArrays

#: Figures of the law: dead time of the torque, s; slope of the dry friction at standstill, N·m·s/rad; largest possible
#: acceleration, rad/s²: more is a sample of another instant than assumed. A bus cycle, s; torque sent next, N·m; speed
#: as measured, rad/s.
LAW: Final = record_type("lead_s", "steepest", "most_rad_s2", "cycle_s", "torque_Nm", "speed_rad_s")


class ShaftLoad(NamedTuple):
    """Rows (B, P) of emulated shafts, their inputs, time (1,) in s; the real shaft (P,); its observed motion (4,), the
    law's figures, transitions of the motion over the lead and over a cycle (4, 4), gains of a cycle (4,)."""

    emulated: Reals2
    inputs: Reals
    time_s: Reals
    real: Reals
    motion: Reals
    law: Annotated[Any, LAW]
    ahead: Reals2
    forward: Reals2
    gain: Reals


@inlined
def later(motion: Vector, forward: Matrix, place: int) -> float:
    """Component `place` of the motion after the time of the `transition` `forward` (4, 4)."""
    # Two parallel sums, as in a vector unit.
    even = forward[place, 0] * motion[0] + forward[place, 2] * motion[2]
    return float(even + (forward[place, 1] * motion[1] + forward[place, 3] * motion[3]))


@entry_point(VECTOR, MATRIX, VECTOR, REAL, allocates=False)
def follow(motion: Vector, forward: Matrix, gain: Vector, position_rad: float) -> None:
    """Update the motion by a position; `forward` (4, 4), `gain` (4,): of the elapsed time."""
    x, v = later(motion, forward, 0), later(motion, forward, 1)
    a, j = later(motion, forward, 2), later(motion, forward, 3)
    off_rad = position_rad - x
    motion[0], motion[1] = x + gain[0] * off_rad, v + gain[1] * off_rad
    motion[2], motion[3] = a + gain[2] * off_rad, j + gain[3] * off_rad


@inlined
def load_torque_Nm(
    emulated: LineArrays, real: LineArrays, time_s: float, x: float, v: float, a: float, steepest: float
) -> float:
    """Load torque that makes the real shaft, at x, v, a at a time, behave as the emulated one.

    steepest: N·m·s/rad, slope of the dry friction at standstill.
    """
    i, r = records.axis(emulated, 0), records.axis(real, 0)
    inertia = laws.mass_kg(i, time_s, records.web(emulated).sample_time_s)
    inertia -= laws.mass_kg(r, time_s, records.web(real).sample_time_s)
    smooth = laws.smooth_resistance_N(i, v) - laws.smooth_resistance_N(r, v)
    smooth += laws.drag_N(i, v) - laws.drag_N(r, v)
    dry = laws.dry_friction_N(i, v) - laws.dry_friction_N(r, v)
    limited = min(max(steepest * v, -abs(dry)), abs(dry)) * (1.0 if dry > 0.0 else -1.0)
    return laws.unbalance_N(i, x) - laws.unbalance_N(r, x) - inertia * a - smooth - limited


@compiled
def put_torque(load: ShaftLoad, b: int, speed_rad_s: float) -> None:
    """Update the load torque of shaft b, by the motion predicted over the lead, from the measured speed."""
    law, motion, ahead = load.law, load.motion, load.ahead
    a = min(max(later(motion, ahead, 2), -law.most_rad_s2), law.most_rad_s2)
    v = speed_rad_s + law.lead_s * (a - 0.5 * law.lead_s * later(motion, ahead, 3))
    emulated, real = records.of_parameters(load.emulated[b]), records.of_parameters(load.real)
    x, external_Nm = later(motion, ahead, 0), load.inputs[1]  # the tension behind the axis
    law.torque_Nm = load_torque_Nm(emulated, real, load.time_s[0], x, v, a, law.steepest) + external_Nm


@compiled
def emulate_shaft(rig: LineArrays, load: ShaftLoad, b: int, row: int, out: Vector, at: int) -> None:
    """Cycle of shaft b on a rig, whose report is in `out` from `at` on: torque of the load motor; the axis's motor
    reports its torque without the feed-forward of the emulated shaft."""
    law, motion, speed, time_s = load.law, load.motion, out[at + rig.m], row * load.law.cycle_s
    if row == 0:
        motion[0], motion[1], motion[2], motion[3] = rig.w[0], rig.w[1], 0.0, 0.0
        law.torque_Nm = records.drive(rig, 1).torque_Nm
    else:
        follow(motion, load.forward, load.gain, out[at])
    emulated = records.of_parameters(load.emulated[b])
    axis, motor = records.axis(emulated, 0), records.motor(emulated, 0)
    if laws.has_feed_forward(motor):
        a, direction = kernel.acceleration_m_s2(rig, time_s, 0), records.mode(rig, 0).direction
        inertia = laws.mass_kg(axis, time_s, records.web(emulated).sample_time_s)
        out[at + 2 * rig.m] -= laws.fed_forward_N(axis, motor, inertia, speed, a, direction)
    # The torque for the measurement at this SYNC is sent with the next.
    records.given(rig, 1).setpoint, load.time_s[0] = law.torque_Nm, time_s
    put_torque(load, b, speed)
