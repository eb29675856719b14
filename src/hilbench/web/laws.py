"""The laws of the web model, each effect's in one place: small compiled functions of parameter rows and state.

Design sections 5 and 6. Every effect is skipped, or multiplies by exactly 1, while its parameters are neutral.
`web` is the web row, `axis` an axis row, `motor` a motor row of `hilbench.web.layout`.
"""

from __future__ import annotations

from math import cos, exp, pi, sin

from numba import njit

from hilbench.web import layout as lay
from hilbench.web.effects import find_effect
from hilbench.web.layout import Vector, place

_COULOMB_N = place("coulomb_friction", "force_N")
_VISCOUS = place("viscous_friction", "coefficient_N_s_per_m")
_STRIBECK_N = place("stribeck_friction", "force_N")
_STRIBECK_SPEED = place("stribeck_friction", "speed_m_s")
_ASYMMETRY = place("friction_asymmetry", "viscous_difference_N_s_per_m")
_ECCENTRICITY_M = place("roller_eccentricity", "amplitude_m")
_ECCENTRICITY_PHASE = place("roller_eccentricity", "phase_rad")
_INERTIA = place("inertia_mismatch", "relative_change")
_GAP_RAD = place("backlash", "gap_rad")
_RIPPLE = place("torque_ripple", "amplitude_Nm")
_RIPPLES = find_effect("torque_ripple").slots
_OFFSET_NM = place("torque_offset", "offset_Nm")
_SCALE = place("torque_scale", "relative_change")
_DELAY_S = place("torque_delay", "delay_s")
_SHIFT = place("elasticity_shift", "relative_change")
_STEP = place("elasticity_step", "time_s")
_STEPS = find_effect("elasticity_step").slots
_DRIFT = place("elasticity_drift", "rate_per_s")
_DAMPING_S = place("web_damping", "time_constant_s")
_CREEP = place("web_slip", "creep_per_N")
_STRAIN_OFFSET = place("strain_offset", "strain")
_DISTURBANCE = place("upstream_disturbance", "amplitude_N")
_DISTURBANCES = find_effect("upstream_disturbance").slots
_LENGTH = place("span_length_error", "relative_change")

#: Tension change (N) at which the iteration for damping with creep stops.
_TENSION_TOLERANCE_N = 1e-10


@njit
def smooth_resistance_N(axis: Vector, v_m_s: float) -> float:
    """Resistance that is continuous in v: b·v + d·|v|."""
    return axis[_VISCOUS] * v_m_s + axis[_ASYMMETRY] * abs(v_m_s)


@njit
def breakaway_N(axis: Vector) -> float:
    """Dry friction at standstill: Fc + Fs."""
    return axis[_COULOMB_N] + axis[_STRIBECK_N]


@njit
def dry_friction_N(axis: Vector, v_m_s: float) -> float:
    """Size of the dry friction at speed v: Fc + Fs·exp(-(v/vs)²)."""
    force = axis[_COULOMB_N]
    if axis[_STRIBECK_N] != 0.0:
        force += axis[_STRIBECK_N] * exp(-((v_m_s / axis[_STRIBECK_SPEED]) ** 2))
    return force


@njit
def web_speed_m_s(axis: Vector, x_m: float, v_m_s: float) -> float:
    """Speed of the web at a roller whose surface turns at v: eccentricity; roller angle phi = x/r."""
    if axis[_ECCENTRICITY_M] == 0.0:
        return v_m_s
    radius = axis[lay.A_RADIUS_M]
    return v_m_s * (1.0 + axis[_ECCENTRICITY_M] / radius * cos(x_m / radius + axis[_ECCENTRICITY_PHASE]))


@njit
def inertia_factor(axis: Vector) -> float:
    """Factor on the moving mass."""
    return 1.0 + axis[_INERTIA]


@njit
def half_gap_m(axis: Vector, motor_rad_per_m: float) -> float:
    """Half the gear play, at the web."""
    return 0.5 * axis[_GAP_RAD] / motor_rad_per_m


@njit
def has_gap(axis: Vector) -> bool:
    """Whether the gear has play."""
    return axis[_GAP_RAD] > 0.0


@njit
def shaft_torque_Nm(motor: Vector, torque_Nm: float, angle_rad: float) -> float:
    """Torque on the shaft from the torque the drive knows: scale, then ripple over the motor's angle."""
    torque = (1.0 + motor[_SCALE]) * torque_Nm
    for slot in range(_RIPPLES):
        at = _RIPPLE + 3 * slot
        if motor[at] != 0.0:
            torque += motor[at] * sin(motor[at + 1] * angle_rad + motor[at + 2])
    return torque


@njit
def measured_torque_Nm(motor: Vector, torque_Nm: float, past: Vector, count: int, sample_time_s: float) -> float:
    """Torque as the drive reports it: `past` holds the torque at sample k in place k % RING; linear in between."""
    delay = motor[_DELAY_S] / sample_time_s
    if delay > 0.0:
        whole = int(delay)
        newer = past[(count - whole) % lay.RING] if count >= whole else past[0]
        older = past[(count - whole - 1) % lay.RING] if count >= whole + 1 else past[0]
        torque_Nm = newer + (older - newer) * (delay - whole)
    return torque_Nm + motor[_OFFSET_NM]


@njit
def step_factor(web: Vector, t_s: float, duration_s: float) -> float:
    """Factor of the steps of E, averaged over [t, t + duration]: exact on the grid, continuous in the step's time."""
    factor = 1.0
    for slot in range(_STEPS):
        at = _STEP + 2 * slot
        if web[at + 1] != 0.0:
            share = min(max((t_s + duration_s - web[at]) / duration_s, 0.0), 1.0)
            factor *= 1.0 + web[at + 1] * share
    return factor


@njit
def stiffness_N(web: Vector, t_s: float, factor_of_steps: float) -> float:
    """E·S with shift, steps and drift."""
    modulus = web[lay.W_MODULUS_PA] * (1.0 + web[_SHIFT]) * factor_of_steps * (1.0 + web[_DRIFT] * t_s)
    return modulus * web[lay.W_SECTION_M2]


@njit
def upstream_strain(web: Vector, strain_prev: float, t_s: float) -> float:
    """Strain of the web that enters, with the disturbance; F_prev is it times W_UPSTREAM_STIFFNESS_N."""
    strain = strain_prev
    for slot in range(_DISTURBANCES):
        at = _DISTURBANCE + 3 * slot
        if web[at] != 0.0:
            wave = web[at] * sin(2.0 * pi * web[at + 1] * t_s + web[at + 2])
            strain += wave / web[lay.W_UPSTREAM_STIFFNESS_N]
    return strain


@njit
def length_factor(web: Vector) -> float:
    """Factor on the nominal length of every span."""
    return 1.0 + web[_LENGTH]


@njit
def span_rates(
    web: Vector,
    stiffness: float,
    strain_prev: float,
    f_next_N: float,
    speed_m_s: Vector,
    material_m: Vector,
    length_m: Vector,
    length_rate_m_s: Vector,
    tension_N: Vector,
    rate_m_s: Vector,
) -> None:
    """Tensions of the K spans and the rates of the unstretched web in them.

    The exact mass conservation of the design, written for the unstretched length w = L/(1 + strain) that lies in
    a span: w' = v1/(1 + strain_prev) - v2/(1 + strain). It holds for any L(t), and a Runge-Kutta step conserves
    the web to rounding. `speed_m_s` (K + 1) are the web speeds at the rollers without creep.
    """
    spans = material_m.size
    scale, offset = length_factor(web), web[_STRAIN_OFFSET]
    damping, creep = web[_DAMPING_S], web[_CREEP]
    for k in range(spans):
        strain = length_m[k] * scale / material_m[k] - 1.0
        tension_N[k] = max(stiffness * (strain - offset), 0.0)
    # Creep needs the tensions and damping needs the speeds: only both together take more than one pass.
    for _ in range(50 if damping > 0.0 and creep > 0.0 else 1):
        change = 0.0
        inflow = speed_m_s[0] / (1.0 + strain_prev)
        for k in range(spans):
            length = length_m[k] * scale
            behind = tension_N[k + 1] if k + 1 < spans else f_next_N
            speed = speed_m_s[k + 1] * (1.0 - creep * (tension_N[k] - behind))
            outflow = speed * (material_m[k] / length)
            rate_m_s[k] = inflow - outflow
            inflow = outflow
            if damping > 0.0:
                stretch = length / material_m[k]
                strain_rate = (length_rate_m_s[k] * scale - stretch * rate_m_s[k]) / material_m[k]
                tension = max(stiffness * (stretch - 1.0 - offset + damping * strain_rate), 0.0)
                change = max(change, abs(tension - tension_N[k]))
                tension_N[k] = tension
        if change < _TENSION_TOLERANCE_N:
            break
