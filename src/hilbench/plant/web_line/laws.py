"""Laws of the web model, each effect's in one place: small compiled functions of a line's records and its motion.

Design sections 5 and 6. Every effect is skipped, or multiplies by exactly 1, while its parameters are neutral. `axis`,
`motor`, `span` and `web` are the records of `hilbench.plant.web_line.layout`.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt

from hilbench.compiled import Record, compiled, inlined, noinline
from hilbench.plant import motor_laws as motors
from hilbench.plant.motor_laws import Slots
from hilbench.plant.web_line import records
from hilbench.plant.web_line.records import LineArrays

#: Width of the change of dry friction around standstill, m/s, for measured motion: a force computed from it must not
#: flip with the noise of v.
FRICTION_WIDTH_M_S = 1e-3
#: Largest phase angle of a twisting shaft's oscillation in an integration step, rad.
_RESONANCE_STEP = 0.2
#: Tension change (N) at which the iteration for damping with creep stops.
_TENSION_TOLERANCE_N = 1e-10
_MOST_PASSES = 100


@inlined
def smooth_resistance_N(axis: Record, v_m_s: float) -> float:
    """Resistance that is continuous in v: b·v + d·|v|; without drag."""
    return viscous(axis) * v_m_s + axis.friction_asymmetry.viscous_difference_N_s_per_m * abs(v_m_s)


@inlined
def viscous(axis: Record) -> float:
    """Viscous friction, N·s/m."""
    return axis.viscous_N_s_per_m + axis.viscous_friction.coefficient_N_s_per_m


@inlined
def coulomb_N(axis: Record) -> float:
    """Dry friction of a part that slides fast."""
    return axis.coulomb_N + axis.coulomb_friction.force_N


@inlined
def drag_N(axis: Record, v_m_s: float) -> float:
    """Aerodynamic drag: c·v·|v|."""
    c = axis.quadratic_drag.coefficient_N_s2_per_m2
    return c * v_m_s * abs(v_m_s) if c != 0.0 else 0.0


@inlined
def breakaway_N(axis: Record) -> float:
    """Dry friction at standstill without a load: Fc + Fs."""
    return coulomb_N(axis) + axis.stribeck_friction.force_N


@inlined
def is_dry(axis: Record) -> bool:
    """True if a roller has dry friction of any kind: it may stick."""
    return breakaway_N(axis) + axis.load_dependent_friction.share != 0.0


@inlined
def load_friction_N(axis: Record, load_N: float) -> float:
    """Magnitude of the load-dependent dry friction: k·|load|."""
    share = axis.load_dependent_friction.share
    return share * abs(load_N) if share != 0.0 else 0.0


@inlined
def dry_friction_N(axis: Record, v_m_s: float) -> float:
    """Magnitude of the dry friction at speed v: Fc + Fs·exp(-(v/vs)²)."""
    force, stribeck = coulomb_N(axis), axis.stribeck_friction
    if stribeck.force_N != 0.0:
        force += stribeck.force_N * exp(-((v_m_s / stribeck.speed_m_s) ** 2))
    return force


@inlined
def unbalance_N(axis: Record, x_m: float) -> float:
    """Force at the web of a roller's unbalance: A·sin(phi + phi0)/r, forward, phi the angle of what is unbalanced."""
    if axis.unbalance.amplitude_Nm == 0.0 and axis.unbalance_Nm == 0.0:
        return 0.0
    phi = x_m / axis.m_per_turned_rad
    torque_Nm = axis.unbalance.amplitude_Nm * sin(phi + axis.unbalance.phase_rad)
    if axis.unbalance_Nm != 0.0:
        torque_Nm += axis.unbalance_Nm * sin(phi + axis.unbalance_phase_rad)
    return torque_Nm / axis.radius_m


@inlined
def measured_resistance_N(axis: Record, x_m: float, v_m_s: float, direction: float) -> float:
    """Resistance of a roller in measured motion: position x, speed v; dry friction, which a simulation treats as an
    event at standstill, acts in a `direction` from -1 to 1 (`motor_laws.measured_direction`), and unbalance is a
    resistance by the angle. Load-dependent friction is the gear's: see `passed_on_N`."""
    resistance = smooth_resistance_N(axis, v_m_s) + direction * dry_friction_N(axis, v_m_s)
    return resistance + drag_N(axis, v_m_s) - unbalance_N(axis, x_m)


@inlined
def passed_on_N(axis: Record, force_N: float, direction: float) -> float:
    """Motor force less its load-dependent friction, for a roller turning in `direction` (-1 to 1)."""
    return force_N - direction * load_friction_N(axis, force_N)


@inlined
def measured_drive_N(axis: Record, motor: Record, torque_Nm: float, x_m: float, v_m_s: float) -> float:
    """Driving force of a roller by measured motion and torque: the motor's, less all resistance but web and inertia."""
    angle_rad, direction = x_m * motor.rad_per_m, motors.measured_direction(v_m_s, FRICTION_WIDTH_M_S)
    drive_N = motor.rad_per_m * shaft_torque_Nm(motor, true_torque_Nm(motor, torque_Nm), angle_rad)
    return passed_on_N(axis, drive_N, direction) - measured_resistance_N(axis, x_m, v_m_s, direction)


@inlined
def web_speed_m_s(axis: Record, x_m: float, v_m_s: float) -> float:
    """Speed of the web at a roller whose surface turns at v: eccentricity; roller angle phi = x/r."""
    off, radius = axis.roller_eccentricity, axis.radius_m
    if off.amplitude_m == 0.0:
        return v_m_s
    return v_m_s * (1.0 + off.amplitude_m / radius * cos(x_m / radius + off.phase_rad))


@inlined
def inertia_factor_at(axis: Record, t_s: float, sample_s: float) -> float:
    """Factor on the moving mass at a time.

    A step grows within the drive's sample before its time, so that a fit can find the time.
    """
    factor = 1.0 + axis.inertia_mismatch.relative_change
    if motors.is_any(axis.inertia_step, 1):
        factor *= _factor_of_steps(axis.inertia_step, t_s, sample_s)
    return factor


@inlined
def mass_kg(axis: Record, t_s: float, sample_s: float) -> float:
    """Mass of roller and motor at a time, without web on it."""
    return (axis.motor_mass_kg + axis.roller_mass_kg) * inertia_factor_at(axis, t_s, sample_s)


@inlined
def acceleration_behind(axis: Record, twist: float, rate: float) -> float:
    """Acceleration of the load behind a twisted shaft: force of spring and damper by its mass.

    twist, rate: how far it is ahead of the motor, and how much faster.
    """
    omega = 2.0 * pi * axis.resonance.frequency_Hz
    return -omega * (omega * twist + 2.0 * axis.resonance.damping * rate)


@inlined
def resonance_steps(axis: Record, period_s: float) -> int:
    """Number of integration steps in a time, for both sides of a twisting shaft to oscillate correctly."""
    omega = 2.0 * pi * axis.resonance.frequency_Hz / sqrt(1.0 - axis.resonance.inertia_share)
    return 1 + int(omega * period_s / _RESONANCE_STEP)


@inlined
def shaft_torque_Nm(motor: Record, torque_Nm: float, angle_rad: float) -> float:
    """Torque on the shaft from the drive's torque: ripple in proportion to it, scale, ripple by the angle."""
    return usual_shaft_torque_Nm(motor, torque_Nm * load_ripple_factor(motor, angle_rad), angle_rad)


@inlined
def usual_shaft_torque_Nm(motor: Record, torque_Nm: float, angle_rad: float) -> float:
    """Torque on the shaft of a motor without ripple in proportion to its torque."""
    return (1.0 + motor.torque_scale.relative_change) * torque_Nm + ripple_Nm(motor, angle_rad)


@inlined
def ripple_Nm(motor: Record, angle_rad: float) -> float:
    """Torque ripple by the angle: sum of A·sin(n·phi_motor + phi0)."""
    return motors.wave_sum(motor.torque_ripple, 1.0, angle_rad, 0.0)


@inlined
def load_ripple_factor(motor: Record, angle_rad: float) -> float:
    """Factor on a torque of ripple in proportion to it: 1 + sum of A·sin(n·phi_motor + phi0)."""
    return motors.wave_sum(motor.torque_ripple_load, 1.0, angle_rad, 1.0)


@inlined
def has_feed_forward(motor: Record) -> bool:
    """True if the recorded torque excludes the feed-forward."""
    fed = motor.feed_forward
    return fed.inertia_share != 0.0 or fed.viscous_share != 0.0 or fed.coulomb_share != 0.0


@inlined
def fed_forward_N(axis: Record, motor: Record, mass_kg: float, v_m_s: float, a_m_s2: float, direction: float) -> float:
    """Feed-forward force, at the web, for a motion: s_J·m·a + s_b·b·v + s_C·Fc·direction (-1 to 1)."""
    fed = motor.feed_forward
    inertia, viscous_N = fed.inertia_share * mass_kg * a_m_s2, fed.viscous_share * viscous(axis) * v_m_s
    return inertia + viscous_N + fed.coulomb_share * coulomb_N(axis) * direction


@inlined
def current_loop_s(motor: Record) -> float:
    """Time constant of the current loop."""
    return max(motor.current_s + motor.drive_lag.lag_s, 0.0)


@inlined
def true_torque_Nm(motor: Record, measured_Nm: float) -> float:
    """Torque produced by the drive, from the reported one: without the offset (the delay is not undone)."""
    return measured_Nm - motor.torque_offset.offset_Nm


@inlined
def step_factor(span: Record, t_s: float, duration_s: float) -> float:
    """Factor of the steps and ramps of E, averaged over [t, t + duration]: continuous in the time of a step."""
    if not (motors.is_any(span.elasticity_step, 1) or motors.is_any(span.elasticity_ramp, 2)):
        return 1.0
    return _step_factor(span, t_s, duration_s)


@compiled
def _factor_of_steps(slots: Slots, t_s: float, duration_s: float) -> float:
    """Factor of steps (time and relative change), averaged over [t, t + duration]."""
    factor = 1.0
    for slot in range(len(slots)):
        if slots[slot, 1] != 0.0:
            share = min(max((t_s + duration_s - slots[slot, 0]) / duration_s, 0.0), 1.0)
            factor *= 1.0 + slots[slot, 1] * share
    return factor


@compiled
def _step_factor(span: Record, t_s: float, duration_s: float) -> float:
    noinline()
    factor, ramps = _factor_of_steps(span.elasticity_step, t_s, duration_s), span.elasticity_ramp
    for slot in range(len(ramps)):
        if ramps[slot, 2] != 0.0:
            share = min(max((t_s + 0.5 * duration_s - ramps[slot, 0]) / ramps[slot, 1], 0.0), 1.0)
            factor *= 1.0 + ramps[slot, 2] * share
    return factor


@inlined
def put_step_factors(line: LineArrays, t_s: float, duration_s: float) -> None:
    """Update `step_factor` of all spans in the scratch space."""
    for j in range(line.k):
        records.part(line, j).step_factor = step_factor(records.span(line, j), t_s, duration_s)


@inlined
def stiffness_N(span: Record, t_s: float, factor_of_steps: float) -> float:
    """E·S with shift, steps, ramps and drift."""
    return span.modulus_Pa * elasticity_factor(span, t_s, factor_of_steps) * span.section_m2


@inlined
def elasticity_factor(span: Record, t_s: float, factor_of_steps: float) -> float:
    """Factor on E by shift, steps, ramps and drift."""
    shift, drift_per_s = span.elasticity_shift.relative_change, span.elasticity_drift.rate_per_s
    return (1.0 + shift) * factor_of_steps * (1.0 + drift_per_s * t_s)


@inlined
def upstream_strain(web: Record, strain_prev: float, t_s: float) -> float:
    """Strain of the web that enters, with the disturbance; F_prev is it times `upstream_stiffness_N`."""
    if motors.is_any(web.upstream_disturbance, 0):
        force_N = motors.wave_sum(web.upstream_disturbance, 2.0 * pi, t_s, 0.0)
        return strain_prev + force_N / web.upstream_stiffness_N
    return strain_prev


@inlined
def downstream_strain(web: Record, f_next_N: float) -> float:
    """Strain of the web after the line, which enters in reverse, by the tension there."""
    return f_next_N / web.downstream_stiffness_N


@inlined
def length_factor(span: Record) -> float:
    """Factor on the nominal length of a span."""
    return 1.0 + span.span_length_error.relative_change


@inlined
def stretch(line: LineArrays, material: int, j: int) -> float:
    """1 + strain of span j, from lengths as in `span_rates`."""
    return line.w[material + line.k + j] * length_factor(records.span(line, j)) / line.w[material + j]


@inlined
def span_rates(line: LineArrays, t_s: float, strain_prev: float, material: int) -> None:
    """Tensions of the K spans and the rates of the unstretched web in them, into the scratch space.

    The exact mass conservation of the design, written for the unstretched length m = L/(1 + strain) in a span: m' =
    v1/(1 + strain_prev) - v2/(1 + strain); in reverse m' = v1/(1 + strain) - v2/(1 + strain_next), as web passes a
    roller with the strain of its origin. It holds for any L(t), and a Runge-Kutta step conserves the web to rounding.

    strain_prev: of the web before the line; tension and strain of that after it follow from the inputs. Read from the
    scratch space: factors of the steps of E, speeds of the web at the rollers without creep, from `material` on
    unstretched (K,) and then nominal lengths (K,), m, and of these the rates.
    """
    creeps = damps = False
    for j in range(line.k):
        span, part = records.span(line, j), records.part(line, j)
        strain = stretch(line, material, j) - 1.0
        part.tension_N = max(stiffness_N(span, t_s, part.step_factor) * (strain - span.strain_offset.strain), 0.0)
        creeps |= span.web_slip.creep_per_N > 0.0
        damps |= span.web_damping.time_constant_s > 0.0
    _flows(line, strain_prev, material)
    if damps:
        _damped(line, t_s, strain_prev, material, creeps)


@inlined
def _flows(line: LineArrays, strain_prev: float, material: int) -> None:
    """Rates of the unstretched web in the spans at these tensions: inflow less outflow, m/s; see `span_rates`."""
    v, f_next_N = records.part(line, 0).speed_m_s, records.boundary(line).F_next_N
    inflow = v / (1.0 + strain_prev) if v >= 0.0 else _unstretched(line, v, material, 0)
    for j in range(line.k):
        v = records.part(line, j + 1).speed_m_s
        if v >= 0.0:
            outflow = _unstretched(line, v, material, j)
        elif j + 1 < line.k:
            outflow = _unstretched(line, v, material, j + 1)
        else:
            outflow = v / (1.0 + downstream_strain(records.web(line), f_next_N))
        if records.span(line, j).web_slip.creep_per_N != 0.0:
            outflow *= creep_factor(line, j, v)
        records.part(line, j).rate_m_s = inflow - outflow
        inflow = outflow


@inlined
def _unstretched(line: LineArrays, v_m_s: float, material: int, j: int) -> float:
    """Unstretched web passing a roller at v, m/s, strained as in span j."""
    length_m = line.w[material + line.k + j] * length_factor(records.span(line, j))
    return v_m_s * line.w[material + j] / length_m


@inlined
def creep_factor(line: LineArrays, j: int, v_m_s: float) -> float:
    """Factor on the web passing the roller after span j: the web slips in the direction of the higher tension,
    whichever way the roller turns."""
    creep = records.span(line, j).web_slip.creep_per_N
    behind_N = records.part(line, j + 1).tension_N if j + 1 < line.k else records.boundary(line).F_next_N
    return 1.0 - (creep if v_m_s >= 0.0 else -creep) * (records.part(line, j).tension_N - behind_N)


@compiled
def _damped(line: LineArrays, t_s: float, strain_prev: float, material: int, creeps: bool) -> None:
    """Add the damping to the tensions. It needs the rates, and with creep the rates need the tensions: iterated."""
    noinline()
    for _ in range(_MOST_PASSES):
        change, creep_before = 0.0, 0.0
        for j in range(line.k):
            span, part, unstretched_m = records.span(line, j), records.part(line, j), line.w[material + j]
            stiffness, damping = stiffness_N(span, t_s, part.step_factor), span.web_damping.time_constant_s
            creep, stretched = span.web_slip.creep_per_N, stretch(line, material, j)
            strain_rate = (part.length_rate_m_s * length_factor(span) - stretched * part.rate_m_s) / unstretched_m
            force = stiffness * (stretched - 1.0 - span.strain_offset.strain + damping * strain_rate)
            # Newton: the tension lowers the strain's rate by creep at the rollers around the span.
            speed = abs(records.part(line, j + 1).speed_m_s)
            slope = stiffness * damping * (creep + creep_before) * speed / unstretched_m
            force = part.tension_N + (max(force, 0.0) - part.tension_N) / (1.0 + slope)
            change = max(change, abs(force - part.tension_N))
            part.tension_N = force
            creep_before = creep
        if not creeps or change < _TENSION_TOLERANCE_N:
            break
        _flows(line, strain_prev, material)
