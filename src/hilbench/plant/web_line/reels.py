"""Laws of reels, compiled: radius and inertia change with the wound web.

A reel's motion refers to its nominal radius r0, that at the start: x = r0·phi, so that x' = r0·omega. A turn winds a
layer of the web's thickness h on or off: r = r0 ∓ h·phi/(2·pi), which is r' = ∓h·v/(2·pi·r) for the web's v = r·omega.
Web that leaves or comes takes its own momentum with it, so that J(r)·omega' is the sum of the torques: there is no
J'·omega.
"""

from __future__ import annotations

from hilbench.compiled import Record, inlined


@inlined
def radius_ratio(axis: Record, x_m: float) -> float:
    """Radius over that at the start, at x, of a reel not below that of the core; 1 of another roller."""
    return max(1.0 + axis.radius_share + axis.reel_slope_per_m * x_m, axis.core_ratio)


@inlined
def web_travel_m(axis: Record, x_m: float) -> float:
    """Travel of the web since the start, m, of a roller at x: of a reel the integral of its radius ratio."""
    return x_m * (1.0 + axis.radius_share + 0.5 * axis.reel_slope_per_m * x_m) if axis.reel_slope_per_m != 0.0 else x_m


@inlined
def mass_kg(axis: Record, x_m: float) -> float:
    """J/r0² of the reel with its web: pi/2·density·width·(r⁴ - r_core⁴) in addition to its own and the motor's."""
    ratio = radius_ratio(axis, x_m)
    return axis.motor_mass_kg + axis.roller_mass_kg + axis.wound_kg * (ratio**4 - axis.core_ratio**4)
