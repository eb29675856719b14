"""Laws of the web model, each effect's in one place: small compiled functions of parameter rows and state.

Design sections 5 and 6. Every effect is skipped, or multiplies by exactly 1, while its parameters are neutral. `p` is
the parameter vector of `hilbench.plant.web_line.layout`; in it, rows begin at `axis`, `motor` and `span`.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt

from hilbench.compiled import compiled, inlined, noinline
from hilbench.plant import motor_laws as motors
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import find_effect
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector, place

_COULOMB_N = place("coulomb_friction", "force_N")
_VISCOUS = place("viscous_friction", "coefficient_N_s_per_m")
_STRIBECK_N = place("stribeck_friction", "force_N")
_STRIBECK_SPEED = place("stribeck_friction", "speed_m_s")
_ASYMMETRY = place("friction_asymmetry", "viscous_difference_N_s_per_m")
_ECCENTRICITY_M = place("roller_eccentricity", "amplitude_m")
_ECCENTRICITY_PHASE = place("roller_eccentricity", "phase_rad")
_INERTIA = place("inertia_mismatch", "relative_change")
_INERTIA_STEP = place("inertia_step", "time_s")
_INERTIA_STEPS = find_effect("inertia_step", MachineKind.SERVO_AXIS).slots
_BEHIND = place("resonance", "inertia_share")
_FREQUENCY_HZ = place("resonance", "frequency_Hz")
_TWIST_DAMPING = place("resonance", "damping")
_UNBALANCE_NM = place("unbalance", "amplitude_Nm")
_UNBALANCE_PHASE = place("unbalance", "phase_rad")
_GAP_RAD = place("backlash", "gap_rad")
_LOAD_SHARE = place("load_dependent_friction", "share")
_DRAG = place("quadratic_drag", "coefficient_N_s2_per_m2")
_LOAD_RIPPLE = place("torque_ripple_load", "relative_amplitude")
_LOAD_RIPPLES = find_effect("torque_ripple_load").slots
_FED_INERTIA = place("feed_forward", "inertia_share")
_FED_VISCOUS = place("feed_forward", "viscous_share")
_FED_COULOMB = place("feed_forward", "coulomb_share")
_ENCODER_RAD = place("encoder_error", "amplitude_rad")
_ENCODER_PHASE = place("encoder_error", "phase_rad")
_KP = place("drive_gain", "kp_relative_change")
_KI = place("drive_gain", "ki_relative_change")
_LAG_S = place("drive_lag", "lag_s")
_RIPPLE = place("torque_ripple", "amplitude_Nm")
_RIPPLES = find_effect("torque_ripple").slots
_OFFSET_NM = place("torque_offset", "offset_Nm")
_SCALE = place("torque_scale", "relative_change")
_DELAY_S = place("torque_delay", "delay_s")
_SHIFT = place("elasticity_shift", "relative_change")
_STEP = place("elasticity_step", "time_s")
_STEPS = find_effect("elasticity_step").slots
_RAMP = place("elasticity_ramp", "time_s")
_RAMPS = find_effect("elasticity_ramp").slots
_DRIFT = place("elasticity_drift", "rate_per_s")
_DAMPING_S = place("web_damping", "time_constant_s")
_CREEP = place("web_slip", "creep_per_N")
_STRAIN_OFFSET = place("strain_offset", "strain")
_DISTURBANCE = place("upstream_disturbance", "amplitude_N")
_DISTURBANCES = find_effect("upstream_disturbance").slots
_LENGTH = place("span_length_error", "relative_change")

#: Width of the change of dry friction around standstill, m/s, for measured motion: a force computed from it must not
#: flip with the noise of v.
FRICTION_WIDTH_M_S = 1e-3
#: Largest phase angle of a twisting shaft's oscillation in an integration step, rad.
_SWING_STEP = 0.2
#: Tension change (N) at which the iteration for damping with creep stops.
_TENSION_TOLERANCE_N = 1e-10
_MOST_PASSES = 100


@inlined
def smooth_resistance_N(p: Vector, axis: int, v_m_s: float) -> float:
    """Resistance that is continuous in v: b·v + d·|v|; without drag."""
    return viscous(p, axis) * v_m_s + p[axis + _ASYMMETRY] * abs(v_m_s)


@inlined
def viscous(p: Vector, axis: int) -> float:
    """Viscous friction, N·s/m."""
    return p[axis + lay.A_VISCOUS] + p[axis + _VISCOUS]


@inlined
def coulomb_N(p: Vector, axis: int) -> float:
    """Dry friction of a part that slides fast."""
    return p[axis + lay.A_COULOMB_N] + p[axis + _COULOMB_N]


@inlined
def drag_N(p: Vector, axis: int, v_m_s: float) -> float:
    """Aerodynamic drag: c·v·|v|."""
    return p[axis + _DRAG] * v_m_s * abs(v_m_s) if p[axis + _DRAG] != 0.0 else 0.0


@inlined
def breakaway_N(p: Vector, axis: int) -> float:
    """Dry friction at standstill without a load: Fc + Fs."""
    return coulomb_N(p, axis) + p[axis + _STRIBECK_N]


@inlined
def is_dry(p: Vector, axis: int) -> bool:
    """True if a roller has dry friction of any kind: it may stick."""
    return breakaway_N(p, axis) + p[axis + _LOAD_SHARE] != 0.0


@inlined
def load_friction_N(p: Vector, axis: int, load_N: float) -> float:
    """Magnitude of the load-dependent dry friction: k·|load|."""
    return p[axis + _LOAD_SHARE] * abs(load_N) if p[axis + _LOAD_SHARE] != 0.0 else 0.0


@inlined
def dry_friction_N(p: Vector, axis: int, v_m_s: float) -> float:
    """Magnitude of the dry friction at speed v: Fc + Fs·exp(-(v/vs)²)."""
    force = coulomb_N(p, axis)
    if p[axis + _STRIBECK_N] != 0.0:
        force += p[axis + _STRIBECK_N] * exp(-((v_m_s / p[axis + _STRIBECK_SPEED]) ** 2))
    return force


@inlined
def has_unbalance(p: Vector, axis: int) -> bool:
    """True if the roller has an unbalance."""
    return p[axis + _UNBALANCE_NM] != 0.0 or p[axis + lay.A_UNBALANCE_NM] != 0.0


@inlined
def unbalance_N(p: Vector, axis: int, x_m: float) -> float:
    """Force at the web of a roller's unbalance: A·sin(phi + phi0)/r, forward, phi the angle of what is unbalanced."""
    return _unbalance_N(p, axis, x_m) if has_unbalance(p, axis) else 0.0


@compiled
def _unbalance_N(p: Vector, axis: int, x_m: float) -> float:
    noinline()
    phi = x_m / p[axis + lay.A_M_PER_TURNED_RAD]
    torque_Nm = p[axis + _UNBALANCE_NM] * sin(phi + p[axis + _UNBALANCE_PHASE])
    if p[axis + lay.A_UNBALANCE_NM] != 0.0:
        torque_Nm += p[axis + lay.A_UNBALANCE_NM] * sin(phi + p[axis + lay.A_UNBALANCE_PHASE])
    return torque_Nm / p[axis + lay.A_RADIUS_M]


@inlined
def has_rare_force(p: Vector, axis: int, motor: int) -> bool:
    """True if a force acts on axis or motor that the usual step leaves out for speed."""
    return (
        has_unbalance(p, axis)
        or p[axis + _DRAG] != 0.0
        or p[axis + _LOAD_SHARE] != 0.0
        or twists(p, axis)
        or motors.is_any(p, motor + _LOAD_RIPPLE, 3, _LOAD_RIPPLES)
    )


@inlined
def measured_resistance_N(p: Vector, axis: int, x_m: float, v_m_s: float, direction: float) -> float:
    """Resistance of a roller in measured motion: position x, speed v; dry friction, which a simulation treats as an
    event at standstill, acts in a `direction` from -1 to 1 (`motor_laws.measured_direction`), and unbalance is a
    resistance by the angle. Load-dependent friction is the gear's: see `passed_on_N`."""
    resistance = smooth_resistance_N(p, axis, v_m_s) + direction * dry_friction_N(p, axis, v_m_s)
    return resistance + drag_N(p, axis, v_m_s) - unbalance_N(p, axis, x_m)


@inlined
def passed_on_N(p: Vector, axis: int, force_N: float, direction: float) -> float:
    """Motor force less its load-dependent friction, for a roller turning in `direction` (-1 to 1)."""
    return force_N - direction * load_friction_N(p, axis, force_N)


@inlined
def pushed_with_N(p: Vector, axis: int, passed_N: float, direction: float) -> float:
    """Motor force for the passed-on one: the inverse of `passed_on_N`."""
    return motors.before_load_friction(p[axis + _LOAD_SHARE], passed_N, direction)


@inlined
def web_speed_m_s(p: Vector, axis: int, x_m: float, v_m_s: float) -> float:
    """Speed of the web at a roller whose surface turns at v: eccentricity; roller angle phi = x/r."""
    if p[axis + _ECCENTRICITY_M] == 0.0:
        return v_m_s
    radius = p[axis + lay.A_RADIUS_M]
    return v_m_s * (1.0 + p[axis + _ECCENTRICITY_M] / radius * cos(x_m / radius + p[axis + _ECCENTRICITY_PHASE]))


@inlined
def eccentric_travel_m(p: Vector, axis: int, x_m: float, end_m: float) -> float:
    """Web travel in excess of the roller's from x to the end by eccentricity: `web_speed_m_s` integrated."""
    if p[axis + _ECCENTRICITY_M] == 0.0:
        return 0.0
    radius, phase = p[axis + lay.A_RADIUS_M], p[axis + _ECCENTRICITY_PHASE]
    return p[axis + _ECCENTRICITY_M] * (sin(end_m / radius + phase) - sin(x_m / radius + phase))


@inlined
def inertia_factor(p: Vector, axis: int) -> float:
    """Factor on the moving mass, without steps."""
    return 1.0 + p[axis + _INERTIA]


@inlined
def has_inertia_step(p: Vector, axis: int) -> bool:
    """True if the moving mass steps."""
    return motors.is_any(p, axis + _INERTIA_STEP + 1, 2, _INERTIA_STEPS)


@inlined
def inertia_factor_at(p: Vector, axis: int, t_s: float) -> float:
    """Factor on the moving mass at a time.

    A step grows within the drive's sample before its time, so that a fit can find the time.
    """
    factor = inertia_factor(p, axis)
    if has_inertia_step(p, axis):
        factor *= _factor_of_steps(p, axis + _INERTIA_STEP, _INERTIA_STEPS, t_s, p[lay.W_SAMPLE_TIME_S])
    return factor


@inlined
def mass_kg(p: Vector, axis: int, t_s: float) -> float:
    """Mass of roller and motor at a time, without web on it."""
    return (p[axis + lay.A_MOTOR_MASS_KG] + p[axis + lay.A_ROLLER_MASS_KG]) * inertia_factor_at(p, axis, t_s)


@inlined
def twists(p: Vector, axis: int) -> bool:
    """True if a part of the moving mass is behind a twisting shaft."""
    return p[axis + _BEHIND] != 0.0


@inlined
def share_behind(p: Vector, axis: int) -> float:
    """Share of the moving mass behind the twisting shaft."""
    return p[axis + _BEHIND]


@inlined
def acceleration_behind(p: Vector, axis: int, twist: float, rate: float) -> float:
    """Acceleration of the load behind a twisted shaft: force of spring and damper by its mass.

    twist, rate: how far it is ahead of the motor, and how much faster.
    """
    omega = 2.0 * pi * p[axis + _FREQUENCY_HZ]
    return -omega * (omega * twist + 2.0 * p[axis + _TWIST_DAMPING] * rate)


@inlined
def twist_under(p: Vector, axis: int, acceleration: float) -> float:
    """Twist of a shaft under steady acceleration."""
    return -acceleration / (2.0 * pi * p[axis + _FREQUENCY_HZ]) ** 2


@inlined
def swing_steps(p: Vector, axis: int, period_s: float) -> int:
    """Number of integration steps in a time, for both sides of a twisting shaft to oscillate correctly."""
    omega = 2.0 * pi * p[axis + _FREQUENCY_HZ] / sqrt(1.0 - p[axis + _BEHIND])
    return 1 + int(omega * period_s / _SWING_STEP)


@inlined
def half_gap_m(p: Vector, axis: int, motor_rad_per_m: float) -> float:
    """Half the gear play, at the web."""
    return 0.5 * p[axis + _GAP_RAD] / motor_rad_per_m


@inlined
def has_gap(p: Vector, axis: int) -> bool:
    """True if the gear has play."""
    return p[axis + _GAP_RAD] > 0.0


@inlined
def shaft_torque_Nm(p: Vector, motor: int, torque_Nm: float, angle_rad: float) -> float:
    """Torque on the shaft from the drive's torque: ripple in proportion to it, scale, ripple by the angle."""
    return usual_shaft_torque_Nm(p, motor, torque_Nm * load_ripple_factor(p, motor, angle_rad), angle_rad)


@inlined
def usual_shaft_torque_Nm(p: Vector, motor: int, torque_Nm: float, angle_rad: float) -> float:
    """Torque on the shaft of a motor without ripple in proportion to its torque."""
    return (1.0 + p[motor + _SCALE]) * torque_Nm + _ripple_Nm(p, motor, angle_rad)


@inlined
def _ripple_Nm(p: Vector, motor: int, angle_rad: float) -> float:
    return motors.wave_sum(p, motor + _RIPPLE, _RIPPLES, angle_rad, 0.0)


@inlined
def load_ripple_factor(p: Vector, motor: int, angle_rad: float) -> float:
    """Factor on a torque of ripple in proportion to it: 1 + sum of A·sin(n·phi_motor + phi0)."""
    return motors.wave_sum(p, motor + _LOAD_RIPPLE, _LOAD_RIPPLES, angle_rad, 1.0)


@inlined
def motor_torque_Nm(p: Vector, motor: int, shaft_Nm: float, angle_rad: float) -> float:
    """Drive torque for this one on the shaft: the inverse of `shaft_torque_Nm`."""
    torque = (shaft_Nm - _ripple_Nm(p, motor, angle_rad)) / (1.0 + p[motor + _SCALE])
    return torque / load_ripple_factor(p, motor, angle_rad)


@inlined
def has_feed_forward(p: Vector, motor: int) -> bool:
    """True if the recorded torque excludes the feed-forward."""
    return p[motor + _FED_INERTIA] != 0.0 or p[motor + _FED_VISCOUS] != 0.0 or p[motor + _FED_COULOMB] != 0.0


@inlined
def fed_forward_N(
    p: Vector, axis: int, motor: int, mass_kg: float, v_m_s: float, a_m_s2: float, direction: float
) -> float:
    """Feed-forward force, at the web, for a motion: s_J·m·a + s_b·b·v + s_C·Fc·direction (-1 to 1)."""
    return (
        p[motor + _FED_INERTIA] * mass_kg * a_m_s2
        + p[motor + _FED_VISCOUS] * viscous(p, axis) * v_m_s
        + p[motor + _FED_COULOMB] * coulomb_N(p, axis) * direction
    )


@inlined
def has_encoder_error(p: Vector, motor: int) -> bool:
    """True if the encoder has an error once per turn."""
    return p[motor + _ENCODER_RAD] != 0.0


@inlined
def measured_motion(p: Vector, motor: int, angle_rad: float, speed_rad_s: float) -> tuple[float, float]:
    """Angle and speed of a motor as measured by its encoder."""
    return motors.measured_motion(p[motor + _ENCODER_RAD], p[motor + _ENCODER_PHASE], angle_rad, speed_rad_s)


@inlined
def true_motion(
    p: Vector, motor: int, angle_rad: float, speed_rad_s: float, acceleration_rad_s2: float
) -> tuple[float, float, float]:
    """True angle, speed and acceleration of a motor from measured ones: the inverse of `measured_motion`."""
    amplitude, phase = p[motor + _ENCODER_RAD], p[motor + _ENCODER_PHASE]
    return motors.true_motion(amplitude, phase, angle_rad, speed_rad_s, acceleration_rad_s2)


@inlined
def velocity_kp(p: Vector, motor: int) -> float:
    """Proportional gain of the velocity loop, N·m·s/rad."""
    return p[motor + lay.M_KP] * (1.0 + p[motor + _KP])


@inlined
def velocity_ki(p: Vector, motor: int) -> float:
    """Integral gain of the velocity loop, N·m/rad."""
    return p[motor + lay.M_KI] * (1.0 + p[motor + _KI])


@inlined
def current_loop_s(p: Vector, motor: int) -> float:
    """Time constant of the current loop."""
    return max(p[motor + lay.M_CURRENT_S] + p[motor + _LAG_S], 0.0)


@inlined
def reporting_delay_s(p: Vector, motor: int) -> float:
    """Dead time of the reported torque."""
    return p[motor + _DELAY_S]


@inlined
def reported_offset_Nm(p: Vector, motor: int) -> float:
    """Offset of the reported torque."""
    return p[motor + _OFFSET_NM]


@inlined
def measured_torque_Nm(p: Vector, motor: int, torque_Nm: float, s: Vector, past: int, count: int) -> float:
    """Torque as the drive reports it: `s` holds the torque of sample k at `past` + k % RING; linear between."""
    delay = p[motor + _DELAY_S] / p[lay.W_SAMPLE_TIME_S]
    if delay > 0.0:
        torque_Nm = motors.past_torque_Nm(s, past, lay.RING, count, delay)
    return torque_Nm + p[motor + _OFFSET_NM]


@inlined
def true_torque_Nm(p: Vector, motor: int, measured_Nm: float) -> float:
    """Torque produced by the drive, from the reported one: without the offset (the delay is not undone)."""
    return measured_Nm - p[motor + _OFFSET_NM]


@inlined
def step_factor(p: Vector, span: int, t_s: float, duration_s: float) -> float:
    """Factor of the steps and ramps of E, averaged over [t, t + duration]: continuous in the time of a step."""
    if not (motors.is_any(p, span + _STEP + 1, 2, _STEPS) or motors.is_any(p, span + _RAMP + 2, 3, _RAMPS)):
        return 1.0
    return _step_factor(p, span, t_s, duration_s)


@compiled
def _factor_of_steps(p: Vector, first: int, slots: int, t_s: float, duration_s: float) -> float:
    """Factor of steps (time and relative change) in slots from `first` on, averaged over [t, t + duration]."""
    factor = 1.0
    for slot in range(slots):
        at = first + 2 * slot
        if p[at + 1] != 0.0:
            share = min(max((t_s + duration_s - p[at]) / duration_s, 0.0), 1.0)
            factor *= 1.0 + p[at + 1] * share
    return factor


@compiled
def _step_factor(p: Vector, span: int, t_s: float, duration_s: float) -> float:
    noinline()
    factor = _factor_of_steps(p, span + _STEP, _STEPS, t_s, duration_s)
    for slot in range(_RAMPS):
        at = span + _RAMP + 3 * slot
        if p[at + 2] != 0.0:
            share = min(max((t_s + 0.5 * duration_s - p[at]) / p[at + 1], 0.0), 1.0)
            factor *= 1.0 + p[at + 2] * share
    return factor


@inlined
def put_step_factors(p: Vector, first: int, spans: int, t_s: float, duration_s: float, w: Vector, at: int) -> None:
    """`step_factor` of all spans (K,), whose rows begin at `first`, at offset `at` of `w`."""
    for k in range(spans):
        w[at + k] = step_factor(p, first + k * lay.SP_SIZE, t_s, duration_s)


@inlined
def stiffness_N(p: Vector, span: int, t_s: float, factor_of_steps: float) -> float:
    """E·S with shift, steps, ramps and drift."""
    return p[span + lay.SP_MODULUS_PA] * elasticity_factor(p, span, t_s, factor_of_steps) * p[span + lay.SP_SECTION_M2]


@inlined
def elasticity_factor(p: Vector, span: int, t_s: float, factor_of_steps: float) -> float:
    """Factor on E by shift, steps, ramps and drift."""
    return (1.0 + p[span + _SHIFT]) * factor_of_steps * (1.0 + p[span + _DRIFT] * t_s)


@inlined
def upstream_strain(p: Vector, strain_prev: float, t_s: float) -> float:
    """Strain of the web that enters, with the disturbance; F_prev is it times W_UPSTREAM_STIFFNESS_N."""
    if motors.is_any(p, _DISTURBANCE, 3, _DISTURBANCES):
        return strain_prev + _disturbance_N(p, t_s) / p[lay.W_UPSTREAM_STIFFNESS_N]
    return strain_prev


@compiled
def _disturbance_N(p: Vector, t_s: float) -> float:
    noinline()
    force = 0.0
    for slot in range(_DISTURBANCES):
        at = _DISTURBANCE + 3 * slot
        if p[at] != 0.0:
            force += p[at] * sin(2.0 * pi * p[at + 1] * t_s + p[at + 2])
    return force


@inlined
def downstream_strain(p: Vector, f_next_N: float) -> float:
    """Strain of the web after the line, which enters in reverse, by the tension there."""
    return f_next_N / p[lay.W_DOWNSTREAM_STIFFNESS_N]


@inlined
def length_factor(p: Vector, span: int) -> float:
    """Factor on the nominal length of a span."""
    return 1.0 + p[span + _LENGTH]


@inlined
def _any_in_spans(p: Vector, first: int, spans: int, place_: int) -> bool:
    """True if a parameter at `place_` of the span rows is above 0 in any of the spans, whose rows begin at `first`."""
    found = False
    for k in range(spans):
        found |= p[first + k * lay.SP_SIZE + place_] > 0.0
    return found


@inlined
def span_rates(
    p: Vector,
    first: int,
    spans: int,
    t_s: float,
    strain_prev: float,
    f_next_N: float,
    strain_next: float,
    w: Vector,
    steps: int,
    speed: int,
    material: int,
    length_rate: int,
    tension: int,
    rate: int,
) -> None:
    """Tensions of the K spans and the rates of the unstretched web in them, in the vector `w` at the given offsets.

    The exact mass conservation of the design, written for the unstretched length m = L/(1 + strain) in a span: m' =
    v1/(1 + strain_prev) - v2/(1 + strain); in reverse m' = v1/(1 + strain) - v2/(1 + strain_next), as web passes a
    roller with the strain of its origin. It holds for any L(t), and a Runge-Kutta step conserves the web to rounding.

    p (P,): parameters, with the rows of the spans from `first` on; spans: K; t_s: since the start; strain_prev: of the
    web before the line; f_next_N, strain_next: tension and strain of that after it. Read from `w`: factors (K,) of the
    steps of E (`steps`), speeds (K + 1,) of the web at the rollers without creep, m/s (`speed`), unstretched (K,) and
    then nominal lengths (K,), m (`material`), rates (K,) of the nominal lengths, m/s (`length_rate`). Written: tensions
    (K,), N (`tension`), and rates (K,) of the unstretched lengths, m/s (`rate`).
    """
    for k in range(spans):
        row = first + k * lay.SP_SIZE
        strain = w[material + spans + k] * length_factor(p, row) / w[material + k] - 1.0
        w[tension + k] = max(stiffness_N(p, row, t_s, w[steps + k]) * (strain - p[row + _STRAIN_OFFSET]), 0.0)
    _flows(p, first, spans, strain_prev, f_next_N, strain_next, w, speed, material, tension, rate)
    if _any_in_spans(p, first, spans, _DAMPING_S):
        _damped(
            p, first, spans, t_s, strain_prev, f_next_N, strain_next, w, steps, speed, material, length_rate, tension,
            rate,
        )  # fmt: skip


@inlined
def _flows(
    p: Vector,
    first: int,
    spans: int,
    strain_prev: float,
    f_next_N: float,
    strain_next: float,
    w: Vector,
    speed: int,
    material: int,
    tension: int,
    rate: int,
) -> None:
    """Rates of the unstretched web in the spans at these tensions: inflow less outflow, m/s.

    Offsets in `w` and units as in `span_rates`; read: `speed`, `material`, `tension`, written: `rate`.
    """
    inflow = w[speed] / (1.0 + strain_prev) if w[speed] >= 0.0 else _unstretched(p, first, spans, w, speed, material, 0)
    for k in range(spans):
        row, v = first + k * lay.SP_SIZE, w[speed + k + 1]
        if v >= 0.0:
            outflow = _unstretched(p, first, spans, w, speed + 1, material, k)
        elif k + 1 < spans:
            outflow = _unstretched(p, first, spans, w, speed, material, k + 1)
        else:
            outflow = v / (1.0 + strain_next)
        if p[row + _CREEP] != 0.0:
            behind = w[tension + k + 1] if k + 1 < spans else f_next_N
            outflow *= creep_factor(p, row, v, w[tension + k] - behind)
        w[rate + k] = inflow - outflow
        inflow = outflow


@inlined
def _unstretched(p: Vector, first: int, spans: int, w: Vector, speed: int, material: int, k: int) -> float:
    """Unstretched web passing a roller, m/s, strained as in span k; `speed`: offset of the speed of span 0's roller."""
    return w[speed + k] * w[material + k] / (w[material + spans + k] * length_factor(p, first + k * lay.SP_SIZE))


@inlined
def creep_factor(p: Vector, span: int, v_m_s: float, less_N: float) -> float:
    """Factor on the web passing the roller after a span, whose tension is by `less_N` lower after it: the web slips in
    the direction of the higher tension, whichever way the roller turns."""
    return 1.0 - (p[span + _CREEP] if v_m_s >= 0.0 else -p[span + _CREEP]) * less_N


@compiled
def _damped(
    p: Vector,
    first: int,
    spans: int,
    t_s: float,
    strain_prev: float,
    f_next_N: float,
    strain_next: float,
    w: Vector,
    steps: int,
    speed: int,
    material: int,
    length_rate: int,
    tension: int,
    rate: int,
) -> None:
    """Add the damping to the tensions. It needs the rates, and with creep the rates need the tensions: iterated.

    Arguments, offsets in `w` and units as in `span_rates`; read: all of them, written: `tension` and `rate`.
    """
    noinline()
    creeps = _any_in_spans(p, first, spans, _CREEP)
    for _ in range(_MOST_PASSES):
        change, creep_before = 0.0, 0.0
        for k in range(spans):
            row = first + k * lay.SP_SIZE
            stiffness, damping, creep = stiffness_N(p, row, t_s, w[steps + k]), p[row + _DAMPING_S], p[row + _CREEP]
            stretch = w[material + spans + k] * length_factor(p, row) / w[material + k]
            strain_rate = (w[length_rate + k] * length_factor(p, row) - stretch * w[rate + k]) / w[material + k]
            force = max(stiffness * (stretch - 1.0 - p[row + _STRAIN_OFFSET] + damping * strain_rate), 0.0)
            # Newton: the tension lowers the strain's rate by creep at the rollers around the span.
            slope = stiffness * damping * (creep + creep_before) * abs(w[speed + k + 1]) / w[material + k]
            force = w[tension + k] + (force - w[tension + k]) / (1.0 + slope)
            change = max(change, abs(force - w[tension + k]))
            w[tension + k] = force
            creep_before = creep
        if not creeps or change < _TENSION_TOLERANCE_N:
            break
        _flows(p, first, spans, strain_prev, f_next_N, strain_next, w, speed, material, tension, rate)
