"""Laws of the servo axis, each in one place: small compiled functions of parameters and state.

Every effect is skipped, or multiplies by exactly 1, while its parameters are neutral. `p` is the parameter vector of
`hilbench.plant.servo_axis.layout`; torques in N·m at the motor shaft, angles in rad, speeds in rad/s.
"""

from __future__ import annotations

from math import exp, pi, sin, sqrt

from hilbench.compiled import compiled, inlined, noinline
from hilbench.plant import drive_loops as loops
from hilbench.plant import motor_laws as motors
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import find
from hilbench.plant.servo_axis.layout import Vector, place

_COULOMB = place("coulomb_friction")
_VISCOUS = place("viscous_friction")
_STRIBECK = place("stribeck_friction", 0)
_STRIBECK_SPEED = place("stribeck_friction", 1)
_ASYMMETRY = place("friction_asymmetry")
_RIPPLE = place("torque_ripple")
_RIPPLES = find("torque_ripple").slots
_OFFSET = place("torque_offset")
_SCALE = place("torque_scale")
_INERTIA = place("inertia_mismatch")
_STEP_TIME = place("inertia_step", 0)
_STEP = place("inertia_step", 1)
_STEP_SIZE = 2
_STEPS = find("inertia_step").slots
_DELAY = place("torque_delay")
_UNBALANCE = place("unbalance", 0)
_UNBALANCE_PHASE = place("unbalance", 1)
_LOAD_SHARE = place("load_dependent_friction")
_DRAG = place("quadratic_drag")
_LOAD_RIPPLE = place("torque_ripple_load")
_LOAD_RIPPLES = find("torque_ripple_load").slots
_FED_INERTIA = place("feed_forward", 0)
_FED_VISCOUS = place("feed_forward", 1)
_FED_COULOMB = place("feed_forward", 2)
_ENCODER = place("encoder_error", 0)
_ENCODER_PHASE = place("encoder_error", 1)
_KP = place("drive_gain", 0)
_KI = place("drive_gain", 1)
_LAG = place("drive_lag")
_BEHIND = place("resonance", 0)
_FREQUENCY = place("resonance", 1)
_DAMPING = place("resonance", 2)
#: Largest phase angle of the oscillation in an integration step, rad.
_SWING_STEP = 0.2


@inlined
def inertia_factor(p: Vector, time_s: float) -> float:
    """Factor on the inertia by effects at a time: (1 + s), and (1 + s_k) of each step from its time on.

    A step grows within the drive's sample before its time, so that a fit can find the time.
    """
    factor = 1.0 + p[_INERTIA]
    return factor * _step_factor(p, time_s) if motors.is_any(p, _STEP, _STEP_SIZE, _STEPS) else factor


@compiled
def _step_factor(p: Vector, time_s: float) -> float:
    noinline()
    factor = 1.0
    for slot in range(_STEPS):
        at = _STEP_SIZE * slot
        reached = (time_s - p[_STEP_TIME + at]) / p[lay.P_SAMPLE_TIME_S] + 1.0
        factor *= 1.0 + p[_STEP + at] * min(max(reached, 0.0), 1.0)
    return factor


@inlined
def inertia_kg_m2(p: Vector, time_s: float) -> float:
    """Inertia of all that turns."""
    return p[lay.P_INERTIA] * inertia_factor(p, time_s)


@inlined
def twists(p: Vector) -> bool:
    """True if a part of the inertia is behind a twisting shaft."""
    return p[_BEHIND] != 0.0


@inlined
def share_behind(p: Vector) -> float:
    """Share of the inertia behind the twisting shaft."""
    return p[_BEHIND]


@inlined
def acceleration_behind(p: Vector, twist_rad: float, twist_rad_s: float) -> float:
    """Acceleration of the load behind a twisted shaft, rad/s²: the spring's and damper's torque by its inertia."""
    omega = 2.0 * pi * p[_FREQUENCY]
    return -omega * (omega * twist_rad + 2.0 * p[_DAMPING] * twist_rad_s)


@inlined
def twist_under(p: Vector, a_rad_s2: float) -> float:
    """Twist of a shaft under steady acceleration, rad."""
    return -a_rad_s2 / (2.0 * pi * p[_FREQUENCY]) ** 2


@inlined
def mean_acceleration(p: Vector, a_rad_s2: float, behind_rad_s2: float) -> float:
    """Mean acceleration of all that turns, from the motor's and that of the load behind the twisting shaft."""
    return a_rad_s2 + p[_BEHIND] * (behind_rad_s2 - a_rad_s2)


@inlined
def swing_steps(p: Vector, period_s: float) -> int:
    """Number of integration steps in a time, for both sides of the shaft to oscillate correctly."""
    omega = 2.0 * pi * p[_FREQUENCY] / sqrt(1.0 - p[_BEHIND])
    return 1 + int(omega * period_s / _SWING_STEP)


@inlined
def smooth_friction_Nm(p: Vector, v_rad_s: float) -> float:
    """Friction that is continuous in the speed: b·v + d·|v| + c·v·|v|."""
    torque = (p[lay.P_VISCOUS] + p[_VISCOUS]) * v_rad_s + p[_ASYMMETRY] * abs(v_rad_s)
    if p[_DRAG] != 0.0:
        torque += p[_DRAG] * v_rad_s * abs(v_rad_s)
    return torque


@inlined
def breakaway_Nm(p: Vector) -> float:
    """Dry friction at standstill without a load: Tc + Ts."""
    return p[lay.P_COULOMB] + p[_COULOMB] + p[_STRIBECK]


@inlined
def is_dry(p: Vector) -> bool:
    """True if there is dry friction of any kind: the shaft may stick."""
    return breakaway_Nm(p) + p[_LOAD_SHARE] != 0.0


@inlined
def load_friction_Nm(p: Vector, load_Nm: float) -> float:
    """Magnitude of the load-dependent dry friction: k·|load|, load the motor's shaft torque."""
    return p[_LOAD_SHARE] * abs(load_Nm) if p[_LOAD_SHARE] != 0.0 else 0.0


@inlined
def dry_friction_Nm(p: Vector, v_rad_s: float) -> float:
    """Magnitude of the dry friction at a speed: Tc + Ts·exp(-(v/vs)²)."""
    torque = p[lay.P_COULOMB] + p[_COULOMB]
    if p[_STRIBECK] != 0.0:
        torque += p[_STRIBECK] * exp(-((v_rad_s / p[_STRIBECK_SPEED]) ** 2))
    return torque


@inlined
def unbalance_Nm(p: Vector, x_rad: float) -> float:
    """Torque of the unbalance: A·sin(phi + phi0), phi = x/i."""
    torque = 0.0
    if p[lay.P_UNBALANCE] != 0.0:
        torque += p[lay.P_UNBALANCE] * sin(x_rad / p[lay.P_GEAR_RATIO] + p[lay.P_UNBALANCE_PHASE])
    if p[_UNBALANCE] != 0.0:
        torque += p[_UNBALANCE] * sin(x_rad / p[lay.P_GEAR_RATIO] + p[_UNBALANCE_PHASE])
    return torque


@inlined
def ripple_Nm(p: Vector, x_rad: float) -> float:
    """Ripple of the motor over its angle."""
    return motors.wave_sum(p, _RIPPLE, _RIPPLES, x_rad, 0.0)


@inlined
def shaft_torque_Nm(p: Vector, torque_Nm: float, x_rad: float) -> float:
    """Shaft torque of the motor for the drive's torque: ripple in proportion to it, scale, ripple by the angle."""
    return (1.0 + p[_SCALE]) * (torque_Nm * _load_ripple_factor(p, x_rad)) + ripple_Nm(p, x_rad)


@inlined
def _load_ripple_factor(p: Vector, x_rad: float) -> float:
    return motors.wave_sum(p, _LOAD_RIPPLE, _LOAD_RIPPLES, x_rad, 1.0)


@inlined
def turned_with_Nm(p: Vector, passed_Nm: float, direction: float) -> float:
    """Shaft torque of the motor before load-dependent friction, from the passed-on one; `direction` -1 to 1."""
    return motors.before_load_friction(p[_LOAD_SHARE], passed_Nm, direction)


@inlined
def motor_torque_Nm(p: Vector, turned_with: float, x_rad: float) -> float:
    """Drive torque for a shaft torque: the inverse of `shaft_torque_Nm`."""
    return (turned_with - ripple_Nm(p, x_rad)) / (1.0 + p[_SCALE]) / _load_ripple_factor(p, x_rad)


@inlined
def has_feed_forward(p: Vector) -> bool:
    """True if the recorded torque excludes the feed-forward."""
    return p[_FED_INERTIA] != 0.0 or p[_FED_VISCOUS] != 0.0 or p[_FED_COULOMB] != 0.0


@inlined
def fed_forward_Nm(p: Vector, time_s: float, v_rad_s: float, a_rad_s2: float, direction: float) -> float:
    """Feed-forward torque for a motion: s_J·J·a + s_b·b·v + s_C·Tc·direction (-1 to 1)."""
    return (
        p[_FED_INERTIA] * inertia_kg_m2(p, time_s) * a_rad_s2
        + p[_FED_VISCOUS] * (p[lay.P_VISCOUS] + p[_VISCOUS]) * v_rad_s
        + p[_FED_COULOMB] * (p[lay.P_COULOMB] + p[_COULOMB]) * direction
    )


@inlined
def has_encoder_error(p: Vector) -> bool:
    """True if the encoder has an error once per turn."""
    return p[_ENCODER] != 0.0


@inlined
def measured_motion(p: Vector, x_rad: float, v_rad_s: float) -> tuple[float, float]:
    """Angle and speed as measured by the drive's encoder."""
    return motors.measured_motion(p[_ENCODER], p[_ENCODER_PHASE], x_rad, v_rad_s)


@inlined
def true_motion(p: Vector, x_rad: float, v_rad_s: float, a_rad_s2: float) -> tuple[float, float, float]:
    """True angle, speed and acceleration from measured ones: the inverse of `measured_motion`."""
    return motors.true_motion(p[_ENCODER], p[_ENCODER_PHASE], x_rad, v_rad_s, a_rad_s2)


@inlined
def velocity_kp(p: Vector, motor: int) -> float:
    """Proportional gain of the velocity loop of motor 0, the drive's, or 1, the load motor's; N·m·s/rad."""
    kp = p[lay.P_LOOPS + motor * loops.LOOPS_SIZE + loops.KP]
    return kp * (1.0 + p[_KP]) if motor == 0 else kp


@inlined
def velocity_ki(p: Vector, motor: int) -> float:
    """Integral gain, N·m/rad."""
    ki = p[lay.P_LOOPS + motor * loops.LOOPS_SIZE + loops.KI]
    return ki * (1.0 + p[_KI]) if motor == 0 else ki


@inlined
def current_loop_s(p: Vector, motor: int) -> float:
    """Time constant of the current loop."""
    time_constant = p[lay.P_LOOPS + motor * loops.LOOPS_SIZE + loops.CURRENT_S]
    return max(time_constant + p[_LAG], 0.0) if motor == 0 else time_constant


@inlined
def reporting_delay_s(p: Vector) -> float:
    """Dead time of the reported torque."""
    return p[_DELAY]


@inlined
def reported_offset_Nm(p: Vector) -> float:
    """Offset of the drive's reported torque."""
    return p[_OFFSET]


@inlined
def reported_torque_Nm(p: Vector, torque_Nm: float, s: Vector) -> float:
    """Torque as the drive reports it: that of delay_s ago, linear between samples, and the offset.

    The recorded past already excludes the feed-forward.
    """
    delay = p[_DELAY] / p[lay.P_SAMPLE_TIME_S]
    if delay > 0.0 or has_feed_forward(p):
        torque_Nm = motors.past_torque_Nm(s, lay.S_PAST, lay.RING, int(s[lay.S_COUNT]), delay)
    return torque_Nm + p[_OFFSET]
