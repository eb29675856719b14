"""Strain trajectory of a span to its set-point, and the speed that follows from it by mass conservation:
functions on a vector; `tension_feed_forward` derives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled, interpreted
from hilbench.topology.sample import CycleSample

Vector = NDArray[np.float64]
Places = NDArray[np.int64]

#: Trajectory of a set-point: rate of the three equal poles, times the rise time; 2 % are left then.
_POLES = 7.5
#: A trajectory: rate of the poles, 1/s, share left of it in a cycle, cycle, span and section; strain, its first and
#: second derivative; lengthening that the samples of the next cycles will show, the next one first (from a command to
#: the sample that shows its effect there are two).
_PER_S, _LEFT, _CYCLE_S, _LENGTH_M, _SECTION_M2, _STRAIN, _RATE_PER_S, _BEND_PER_S2, _SHOWN, _SHOWN_NEXT, _SIZE = range(
    11
)
#: What enters a span, on the side before it and then on that behind it: strain while nothing is known, and section of
#: the span there; places of its tension and E, NOWHERE: it stays so.
_WANTED, _OF_SECTION_M2, _ENTERING = range(3)
_TENSION_AT, _MODULUS_AT, _PLACES = range(3)
NOWHERE = -1


def trajectory_per_s(rise_s: float) -> float:
    """Rate of the three equal poles of a trajectory, of which 98 % are made in `rise_s`."""
    return _POLES / rise_s


@compiled
def trajectory_update(w: Vector, goal_N: float, modulus_Pa: float) -> None:
    """Advance the trajectory by a cycle towards the goal."""
    per_s, duration_s, left = w[_PER_S], w[_CYCLE_S], w[_LEFT]
    goal = goal_N / (modulus_Pa * w[_SECTION_M2])
    off = w[_STRAIN] - goal
    slope = w[_RATE_PER_S] + per_s * off
    bend = 0.5 * (w[_BEND_PER_S2] + 2.0 * per_s * w[_RATE_PER_S] + per_s * per_s * off)
    off = (off + (slope + bend * duration_s) * duration_s) * left
    sloping = (slope + 2.0 * bend * duration_s) * left
    w[_STRAIN] = goal + off
    w[_RATE_PER_S] = sloping - per_s * off
    w[_BEND_PER_S2] = 2.0 * bend * left - 2.0 * per_s * sloping + per_s * per_s * off
    w[_SHOWN], w[_SHOWN_NEXT] = w[_SHOWN_NEXT], w[_LENGTH_M] * w[_RATE_PER_S]


@compiled
def lengthening_m_s2(w: Vector) -> float:
    """L·ε''."""
    return float(w[_LENGTH_M] * w[_BEND_PER_S2])


@compiled
def shown_m_s(w: Vector) -> float:
    """Lengthening that the last sample is to show."""
    return float(w[_SHOWN])


@compiled
def trajectory_tension_N(w: Vector, modulus_Pa: float) -> float:
    """Wanted tension at this moment."""
    return float(w[_STRAIN] * modulus_Pa * w[_SECTION_M2])


@compiled
def trajectory_velocity(w: Vector, behind_m_s: float, entering_strain: float) -> float:
    """Velocity of the axis before the span by mass conservation, from that of the axis after it and the strain that
    enters, in reverse that of the web after the span."""
    wanted, lengthening_m_s = 1.0 + w[_STRAIN], w[_LENGTH_M] * w[_RATE_PER_S]
    if behind_m_s < 0.0:
        return float(behind_m_s * wanted / (1.0 + entering_strain) - lengthening_m_s / wanted)
    return float((behind_m_s - lengthening_m_s / wanted) * (1.0 + entering_strain) / wanted)


@compiled
def entering_strain(entering: Vector, at: Places, values: Vector, forward: bool, fresh: bool) -> float:
    """Strain of the web that enters, from what the twin has sent last, where that is `fresh`."""
    side = 0 if forward else 1
    of, place = entering[side * _ENTERING :], at[side * _PLACES :]
    if not fresh or place[_MODULUS_AT] == NOWHERE:
        return float(of[_WANTED])
    modulus_Pa = values[place[_MODULUS_AT]]
    if not modulus_Pa > 0.0:
        return float(of[_WANTED])
    return float(values[place[_TENSION_AT]] / (modulus_Pa * of[_OF_SECTION_M2]))


_update, _velocity, _tension_N = (
    interpreted(trajectory_update),
    interpreted(trajectory_velocity),
    interpreted(trajectory_tension_N),
)


class StrainTrajectory:
    """Strain trajectory of a span: smooth change to the strain of the set-point at the present E.

    Three equal poles; `rise_s`: until 98 % of a step are made. A change of E moves the goal, and keeps the present
    strain, as it keeps that of the web: the controller sees only the web's deviation from its trajectory back.
    """

    def __init__(self, rise_s: float, cycle_s: float, length_m: float, section_m2: float) -> None:
        per_s = trajectory_per_s(rise_s)
        self.vector = np.zeros(_SIZE)  #: of the functions above
        self.vector[: _SECTION_M2 + 1] = per_s, exp(-per_s * cycle_s), cycle_s, length_m, section_m2

    def reset(self, strain: float) -> None:
        """Reset to rest at this strain."""
        self.vector[_STRAIN:] = 0.0
        self.vector[_STRAIN] = strain

    def update(self, goal_N: float, modulus_Pa: float) -> None:
        """`trajectory_update`."""
        _update(self.vector, goal_N, modulus_Pa)

    @property
    def lengthening_m_s(self) -> float:
        """L·ε'."""
        return float(self.vector[_LENGTH_M] * self.vector[_RATE_PER_S])

    @property
    def lengthening_m_s2(self) -> float:
        """L·ε''."""
        return float(self.vector[_LENGTH_M] * self.vector[_BEND_PER_S2])

    def tension_N(self, modulus_Pa: float) -> float:
        """`trajectory_tension_N`."""
        return _tension_N(self.vector, modulus_Pa)

    def velocity(self, behind_m_s: float, entering_strain: float) -> float:
        """`trajectory_velocity`."""
        return _velocity(self.vector, behind_m_s, entering_strain)


@dataclass(frozen=True)
class EnteringStrain:
    """Strain of the web that may enter a span: as the twin has it of another span, by the signals of that one's tension
    and E and its section; `wanted` while nothing is known of it, and where there is no such span."""

    wanted: float
    tension: str = ""
    modulus: str = ""
    section_m2: float = 0.0


def entering_vectors(kind: type[CycleSample], sides: Sequence[EnteringStrain]) -> tuple[Vector, Places]:
    """Vectors of `entering_strain`: of the web before the span, then of that after it."""
    figures = [value for side in sides for value in (side.wanted, side.section_m2)]
    places = [kind.place(name) if name else NOWHERE for side in sides for name in (side.tension, side.modulus)]
    return np.array(figures), np.array(places, np.int64)
