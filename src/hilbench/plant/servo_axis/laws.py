"""The laws of the servo axis, each in one place: small compiled functions of parameters and state.

Every effect is skipped, or multiplies by exactly 1, while its parameters are neutral. `p` is the parameter vector of
`hilbench.plant.servo_axis.layout`; torques in N·m at the motor shaft, angles in rad, speeds in rad/s.
"""

from __future__ import annotations

from math import exp, sin

from hilbench.compiled import compiled, inlined, noinline
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
_DELAY = place("torque_delay")
_UNBALANCE = place("unbalance", 0)
_UNBALANCE_PHASE = place("unbalance", 1)


@inlined
def inertia_kg_m2(p: Vector) -> float:
    """All that turns."""
    return p[lay.P_INERTIA] * (1.0 + p[_INERTIA])


@inlined
def smooth_friction_Nm(p: Vector, v_rad_s: float) -> float:
    """Friction that is continuous in the speed: b·v + d·|v|."""
    return (p[lay.P_VISCOUS] + p[_VISCOUS]) * v_rad_s + p[_ASYMMETRY] * abs(v_rad_s)


@inlined
def breakaway_Nm(p: Vector) -> float:
    """Dry friction at standstill: Tc + Ts."""
    return p[lay.P_COULOMB] + p[_COULOMB] + p[_STRIBECK]


@inlined
def dry_friction_Nm(p: Vector, v_rad_s: float) -> float:
    """Size of the dry friction at a speed: Tc + Ts·exp(-(v/vs)²)."""
    torque = p[lay.P_COULOMB] + p[_COULOMB]
    if p[_STRIBECK] != 0.0:
        torque += p[_STRIBECK] * exp(-((v_rad_s / p[_STRIBECK_SPEED]) ** 2))
    return torque


@inlined
def unbalance_Nm(p: Vector, x_rad: float) -> float:
    """Torque of what is unbalanced: A·sin(phi + phi0), phi = x/i."""
    torque = 0.0
    if p[lay.P_UNBALANCE] != 0.0:
        torque += p[lay.P_UNBALANCE] * sin(x_rad / p[lay.P_GEAR_RATIO] + p[lay.P_UNBALANCE_PHASE])
    if p[_UNBALANCE] != 0.0:
        torque += p[_UNBALANCE] * sin(x_rad / p[lay.P_GEAR_RATIO] + p[_UNBALANCE_PHASE])
    return torque


@inlined
def ripple_Nm(p: Vector, x_rad: float) -> float:
    """Ripple of the motor over its angle: sum of A·sin(n·x + phi0)."""
    found = False
    for slot in range(_RIPPLES):
        found |= p[_RIPPLE + 3 * slot] != 0.0
    return _ripple_Nm(p, x_rad) if found else 0.0


@compiled
def _ripple_Nm(p: Vector, x_rad: float) -> float:
    noinline()
    torque = 0.0
    for slot in range(_RIPPLES):
        at = _RIPPLE + 3 * slot
        if p[at] != 0.0:
            torque += p[at] * sin(p[at + 1] * x_rad + p[at + 2])
    return torque


@inlined
def scaled_torque_Nm(p: Vector, torque_Nm: float) -> float:
    """What of the torque that the drive knows acts on the shaft."""
    return (1.0 + p[_SCALE]) * torque_Nm


@inlined
def reported_offset_Nm(p: Vector) -> float:
    """What the reported torque of the drive is off by."""
    return p[_OFFSET]


@inlined
def reported_torque_Nm(p: Vector, torque_Nm: float, s: Vector) -> float:
    """Torque as the drive reports it: that of delay_s ago, linear between samples, and the offset."""
    delay = p[_DELAY] / p[lay.P_SAMPLE_TIME_S]
    if delay > 0.0:
        count, whole = int(s[lay.S_COUNT]), int(delay)
        newer = s[lay.S_PAST + max(count - whole, 0) % lay.RING]
        older = s[lay.S_PAST + max(count - whole - 1, 0) % lay.RING]
        torque_Nm = newer + (older - newer) * (delay - whole)
    return torque_Nm + p[_OFFSET]
