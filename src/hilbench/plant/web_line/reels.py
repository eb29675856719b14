"""Laws of reels, compiled: radius and inertia change with the wound web.

A reel's motion refers to its nominal radius r0, that at the start: x = r0·phi, so that x' = r0·omega. A turn winds a
layer of the web's thickness h on or off: r = r0 ∓ h·phi/(2·pi), which is r' = ∓h·v/(2·pi·r) for the web's v = r·omega.
Web that leaves or comes takes its own momentum with it, so that J(r)·omega' is the sum of the torques: there is no
J'·omega.
"""

from __future__ import annotations

from hilbench.compiled import inlined
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


@inlined
def is_reel(p: Vector, axis: int) -> bool:
    """True if the roller whose row begins at `axis` is a reel."""
    return p[axis + lay.A_REEL_SLOPE_PER_M] != 0.0


@inlined
def radius_ratio(p: Vector, axis: int, x_m: float) -> float:
    """Radius over that at the start, at x; not below that of the core."""
    return max(1.0 + p[axis + lay.A_RADIUS_SHARE] + p[axis + lay.A_REEL_SLOPE_PER_M] * x_m, p[axis + lay.A_CORE_RATIO])


@inlined
def web_travel_m(p: Vector, axis: int, x_m: float) -> float:
    """Travel of the web since the start, m, of a reel at x: the integral of its radius ratio."""
    return x_m * (1.0 + p[axis + lay.A_RADIUS_SHARE] + 0.5 * p[axis + lay.A_REEL_SLOPE_PER_M] * x_m)


@inlined
def mass_kg(p: Vector, axis: int, x_m: float) -> float:
    """J/r0² of the reel with its web: pi/2·density·width·(r⁴ - r_core⁴) in addition to its own and the motor's."""
    ratio, core = radius_ratio(p, axis, x_m), p[axis + lay.A_CORE_RATIO]
    own = p[axis + lay.A_MOTOR_MASS_KG] + p[axis + lay.A_ROLLER_MASS_KG]
    return own + p[axis + lay.A_WOUND_KG] * (ratio**4 - core**4)
