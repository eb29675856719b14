"""Torque that the motion of another axis makes at a joint: of a rigid arm of two links, from the angles of both.

The joint carries the other's link, or is carried by it. With φ the joint's own angle, ψ the other's (that of the joint
that is carried relative to the link that carries it), and θ = ψ of a joint that carries, φ of one that is carried:

- carries: φ″ and ψ″;  cos θ·(ψ″ + 2φ″) − sin θ·ψ′(ψ′ + 2φ′);  sin(φ + ψ) and cos(φ + ψ), gravity of the other's link,
- carried: φ″ and ψ″;  cos θ·ψ″ + sin θ·ψ′²;  its own gravity goes with φ + ψ.

The torque has any multiple of each (the equations of a planar arm of two links: Spong, Hutchinson and Vidyasagar, Robot
Modeling and Control, chapter 7), of the third with any phase of θ. What is carried adds to the joint's own inertia.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.stretched_problem import StretchedProblem

#: Share of what is left of the torque by a joint alone, its stretches predicted from one another, that the other's
#: motion has to explain; and what it may leave of the torque's rms where they are an arm.
_LEAST_SHARE, _MOST_LEFT = 0.25, 0.15
#: Rows per column from which a regression is one.
_LEAST_ROWS: Final = 4


class Arm(StrEnum):
    """Place of a joint in an arm."""

    CARRIES = "carries the other axis"
    CARRIED = "carried by the other axis"


@dataclass(frozen=True)
class Motion:
    """Angle, speed and acceleration of a joint (n,): rad, rad/s, rad/s²."""

    angle: Array
    speed: Array
    acceleration: Array


def columns(arm: Arm, own: Motion, other: Motion) -> dict[str, Array]:
    """Torque (n,) per unit of each coupling, by name."""
    elbow = other.angle if arm is Arm.CARRIES else own.angle
    if arm is Arm.CARRIES:
        oscillating, turning = (
            other.acceleration + 2.0 * own.acceleration,
            other.speed * (other.speed + 2.0 * own.speed),
        )
    else:
        oscillating, turning = other.acceleration, -(other.speed**2)
    found = {
        "own_inertia_change_kg_m2": own.acceleration,
        "inertia_kg_m2": other.acceleration,
        "arm_kg_m2": np.cos(elbow) * oscillating - np.sin(elbow) * turning,
        "arm_turned_kg_m2": np.sin(elbow) * oscillating + np.cos(elbow) * turning,
    }
    if arm is Arm.CARRIES:
        both = own.angle + other.angle
        found |= {"gravity_sin_Nm": np.sin(both), "gravity_cos_Nm": np.cos(both)}
    return found


def by_accelerations(arm: Arm, own: Motion, other: Motion) -> Array:
    """(2, couplings, n): by how much the torque per unit of each coupling changes with the joint's own acceleration,
    and with the other's."""
    still, one = np.zeros(len(own.angle)), np.ones(len(own.angle))

    def at(acceleration: Array, others: Array) -> Array:
        found = columns(arm, Motion(own.angle, still, acceleration), Motion(other.angle, still, others))
        return np.array(list(found.values()))

    return np.array([at(one, still), at(still, one)]) - at(still, still)


def left_unseen(torque: Array, explaining: Array) -> float:
    """Share of the rms of a torque (m,) that columns (J, m) leave, its stretches predicted from one another; inf where
    there are too few rows."""
    if len(torque) < _LEAST_ROWS * len(explaining):
        return float("inf")
    scaled = explaining / np.maximum(np.linalg.norm(explaining, axis=1), 1e-300)[:, None]
    problem = StretchedProblem.of(torque[None], scaled[:, None])
    return float(np.sqrt(problem.left_unseen(list(range(len(scaled)))) / max(float(np.sum(torque**2)), 1e-300)))


def likelier(left: Mapping[Arm, Sequence[float]]) -> Arm:
    """More likely place of the joint, from each arm's unexplained share of the torque's rms by corner: the smaller,
    in the geometric mean of the corners at which either may be one and both are known."""
    shares = np.array([left[arm] for arm in Arm])
    is_identified = np.all(np.isfinite(shares), axis=0) & np.any(shares < _MOST_LEFT, axis=0)
    counted = shares[:, is_identified] if np.any(is_identified) else np.min(shares, axis=1, keepdims=True)
    return list(Arm)[int(np.argmin(np.mean(np.log(np.maximum(counted, 1e-300)), axis=1)))]


def explains(beside: float, alone: float) -> bool:
    """True if the other's motion leaves little, and clearly less than the joint alone does."""
    return beside < min((1.0 - _LEAST_SHARE) * alone, _MOST_LEFT)
