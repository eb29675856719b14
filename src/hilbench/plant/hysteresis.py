"""Presliding hysteresis: after a reversal dry friction changes over a travel, and after the gear play.

A sliding spring (Prandtl's element; Al-Bender, Swevers, *Characterization of friction force dynamics*, IEEE Control
Systems Magazine 2008), in series with a play: from the stop on one side the spring relaxes, the play is crossed without
force, the spring is wound up the other way, and friction slides. Inertia is neglected: friction holds the load side of
the play until the play is crossed. Travel in the unit of the position.
"""

from __future__ import annotations

from typing import Final

from hilbench.compiled import REAL, VECTOR, Vector, entry_point, inlined

#: Least travel over which friction reverses.
LEAST_PRESLIDING: Final = 1e-9


@inlined
def wound(deflection: float, step: float, half_play: float, presliding: float) -> float:
    """Deflection of play and spring together after a step of the motion; at their ends both are dragged along."""
    end = half_play + presliding
    return min(max(deflection + step, -end), end)


@inlined
def friction_direction(deflection: float, half_play: float, presliding: float) -> float:
    """Dry friction as a share of sliding friction, with the sign of the motion: -1 to 1."""
    share = min(max((abs(deflection) - half_play) / presliding, 0.0), 1.0)
    return share if deflection > 0.0 else -share


#: friction_directions(position (n,), half_play, presliding, out (n,)): direction at each row, from no deflection.
@entry_point(VECTOR, REAL, REAL, VECTOR)
def friction_directions(x: Vector, half_play: float, presliding: float, out: Vector) -> None:
    deflection = 0.0
    for k in range(len(x)):
        step = x[k] - x[k - 1] if k > 0 else 0.0
        deflection = wound(deflection, step, half_play, presliding)
        out[k] = friction_direction(deflection, half_play, presliding)
