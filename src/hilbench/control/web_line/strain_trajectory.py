"""Strain trajectory of a span to its set-point, and the speed that follows from it by mass conservation:
`feed_forward` derives them.

Smooth change to the strain of the set-point at the present E, with three equal poles. A change of E moves the goal, and
keeps the present strain, as it keeps that of the web: the controller sees only the web's deviation from its trajectory
back.
"""

from __future__ import annotations

from math import exp
from typing import Any

import numpy as np

from hilbench.compiled import Vector, compiled, record_at, record_type

#: Rate of the three equal poles, times the rise time; 2 % are left then.
_POLES = 7.5
TRAJECTORY = record_type(
    "per_s",  # rate of the poles; 0: the span has no trajectory
    "left",  # share left of it in a step
    "step_s",
    "length_m",
    "section_m2",
    "strain",
    "rate_per_s",
    "bend_per_s2",
    "tension_N",  # wanted at E of the last step
    # Lengthening that the samples of the next steps will show: from a command to the sample that shows its effect there
    # are two.
    "shown_m_s",
    "shown_next_m_s",
)


@compiled
def advance(t: Any, goal_N: float, modulus_Pa: float) -> None:
    """Advance a `TRAJECTORY` by a step towards the goal."""
    per_s, step_s, left = t.per_s, t.step_s, t.left
    goal = goal_N / (modulus_Pa * t.section_m2)
    off = t.strain - goal
    slope = t.rate_per_s + per_s * off
    bend = 0.5 * (t.bend_per_s2 + 2.0 * per_s * t.rate_per_s + per_s * per_s * off)
    off = (off + (slope + bend * step_s) * step_s) * left
    sloping = (slope + 2.0 * bend * step_s) * left
    t.strain = goal + off
    t.rate_per_s = sloping - per_s * off
    t.bend_per_s2 = 2.0 * bend * left - 2.0 * per_s * sloping + per_s * per_s * off
    t.shown_m_s, t.shown_next_m_s = t.shown_next_m_s, t.length_m * t.rate_per_s
    t.tension_N = wanted_tension_N(t, modulus_Pa)


@compiled
def wanted_tension_N(t: Any, modulus_Pa: float) -> float:
    """Wanted tension at this moment."""
    return float(t.strain * modulus_Pa * t.section_m2)


@compiled
def velocity_before(t: Any, behind_m_s: float, entering_strain: float) -> float:
    """Velocity of the axis before the span by mass conservation, from that of the axis after it and the strain that
    enters, in reverse that of the web after the span."""
    wanted, lengthening_m_s = 1.0 + t.strain, t.length_m * t.rate_per_s
    if behind_m_s < 0.0:
        return float(behind_m_s * wanted / (1.0 + entering_strain) - lengthening_m_s / wanted)
    return float((behind_m_s - lengthening_m_s / wanted) * (1.0 + entering_strain) / wanted)


def strain_trajectory(rise_s: float, step_s: float, length_m: float, section_m2: float, strain: float = 0.0) -> Vector:
    """`TRAJECTORY` at rest at a strain; `rise_s`: until 98 % of a step are made."""
    vector = np.zeros(TRAJECTORY.itemsize // 8)
    t = record_at(vector, TRAJECTORY)
    t.per_s, t.left, t.step_s = _POLES / rise_s, exp(-_POLES / rise_s * step_s), step_s
    t.length_m, t.section_m2, t.strain = length_m, section_m2, strain
    return vector
