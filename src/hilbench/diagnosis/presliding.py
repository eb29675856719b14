"""Presliding: displacement over which an axis's dry friction turns over after a reversal, from motion and torque.

Before friction slides it is a spring. Where that displacement shows, what happens at reversals is one law, and friction
read far from them alone is not mistaken for one that grows with the speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.optimize import minimize

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.coupling import Motion
from hilbench.diagnosis.noise import repeats
from hilbench.plant.hysteresis import LEAST_PRESLIDING, friction_directions

#: Sliding lengths that are tried: the ratio of one to the next, the longest as a share of the travel of the axis, and
#: how long the shortest takes at a usual reversal, in periods of the band; plays beside each, in that length.
_NEXT, _LONGEST, _SHORTEST = 1.26, 0.1, 0.05
_PLAYS: Final = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
#: Share of what is left without it that a sliding length has to explain, a quarter of it in every stretch of the
#: recording; an axis that reverses less often shows none.
_LEAST_SHARE, _STRETCHES, _LEAST_REVERSALS = 0.03, 2, 4
#: Share of what is left by which a sliding length may explain less than a play and be taken for what is there.
_AS_WELL: Final = 0.03
#: Share of the torque that may be left: what acts on an axis from elsewhere turns round with it as well.
_MOST_LEFT: Final = 0.5
#: Ratio of a sliding length to the next in the search for the ends of its interval, and most of them.
_STEP, _STEPS = 1.03, 30
#: Rise of the sum of squares, in variances, up to which a sliding length may be the right one: 95 % of one parameter.
_RISE: Final = 3.84


@dataclass(frozen=True)
class Presliding:
    """Presliding displacement, in the unit of the position, with its 95 % interval."""

    presliding_travel: float
    ci95: tuple[float, float]


def shortest(motion: Motion, highest_Hz: float) -> float:
    """Least sliding length that is looked for in torques up to a frequency: one that is found in none may be there."""
    reverses = np.flatnonzero(np.diff(np.sign(motion.speed)) != 0.0)
    rate = float(np.median(np.abs(motion.acceleration[reverses]))) if len(reverses) else 0.0
    longest = _LONGEST * float(np.ptp(motion.angle))
    return float(np.clip(0.5 * rate * (_SHORTEST / highest_Hz) ** 2, 1e-6 * longest, longest / _NEXT))


def presliding(
    motion: Motion,
    torque: Array,
    compared: Callable[[Array], Array],
    rows: Rows,
    least: float,
    others: Sequence[Array] = (),
    *,
    may_play: bool = True,
) -> Presliding | None:
    """Presliding displacement that explains the torque best, fitted with inertia, offset and viscous friction.

    motion: of the axis, on any grid; torque (n,), as `compared` makes it of values on that grid; rows (n,): those that
    count; least: the shortest that is tried; others (n,): torques of which any multiple may be there; may_play: True if
    the machine may have a play in series, which is fitted with it. None where friction that turns over with the sign of
    the speed explains as much.
    """
    x, v = motion.angle, motion.speed
    columns = compared(np.array([motion.acceleration, v, np.abs(v), np.ones(len(x)), x - np.mean(x)]))
    slow = np.abs(columns[1]) < 1e-9 * np.max(np.abs(columns[1]))
    if np.count_nonzero(np.diff(np.sign(columns[1][rows & ~slow]))) < _LEAST_REVERSALS:
        return None
    columns = np.array([*columns, *others])[:, rows]
    fixed, _ = np.linalg.qr((columns / np.maximum(np.linalg.norm(columns, axis=1), 1e-300)[:, None]).T)
    beside = torque[rows] - fixed @ (fixed.T @ torque[rows])

    def left(direction: Array) -> Array:
        turning = compared(direction)[rows]
        turning = turning - fixed @ (fixed.T @ turning)
        return np.asarray(beside - turning * float(turning @ beside) / max(float(turning @ turning), 1e-300))

    def square(presliding_travel: float, play: float) -> float:
        return float(np.sum(left(_direction(x, presliding_travel, play)) ** 2))

    longest, tried = _LONGEST * float(np.ptp(x)), _PLAYS if may_play else (0.0,)
    lengths = np.geomspace(least, longest, 2 + int(np.log(longest / least) / np.log(_NEXT)))
    squares = np.array([[square(length, play * length) for play in tried] for length in lengths])
    best, alone = int(np.argmin(np.min(squares, axis=1))), int(np.argmin(squares[:, 0]))
    # Presliding and play look alike in the band; every friction has it, so it is one where that explains as much.
    may_play = may_play and float(squares[alone, 0]) > (1.0 + _AS_WELL) * float(np.min(squares))
    if not may_play:
        best = alone
    if best in (0, len(lengths) - 1):
        return None
    plays = _PLAYS if may_play else (0.0,)
    play = plays[int(np.argmin(squares[best, : len(plays)]))]
    sudden = min(
        (left(_direction(x, LEAST_PRESLIDING, p * lengths[best])) for p in plays),
        key=lambda rest: float(np.sum(rest**2)),
    )
    here = left(_direction(x, lengths[best], play * lengths[best]))
    if not _explains(here, sudden):
        return None
    if np.std(here) > _MOST_LEFT * np.std(torque[rows]):
        return None
    # Closer: both make up for each other, so the profile over the displacement has the best play at each.
    first, gap = float(lengths[best]), play * float(lengths[best])

    def gap_near(at: Array) -> float:
        return max(gap + first * float(at[1]), 0.0) if may_play else 0.0

    def near(at: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        return square(first * float(np.exp(at[0])), gap_near(at))

    simplex = np.array([[-0.2, -0.2], [0.2, -0.2], [0.0, 0.2]])
    closest = minimize(near, np.zeros(2), method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 60})
    presliding_travel, gap = first * float(np.exp(closest.x[0])), gap_near(closest.x)
    variance = float(np.mean(here**2)) * repeats(here)

    def fits(other: float) -> bool:
        plays = gap + (presliding_travel - other) * np.linspace(0.0, 2.0, 5) if may_play else np.zeros(1)
        return min(square(other, max(float(p), 0.0)) for p in plays) <= float(closest.fun) + _RISE * variance

    return Presliding(
        presliding_travel, (_furthest(presliding_travel, 1.0 / _STEP, fits), _furthest(presliding_travel, _STEP, fits))
    )


def _furthest(presliding_travel: float, factor: float, fits: Callable[[float], bool]) -> float:
    """First sliding length, ever further from the best one, that does not fit any more."""
    for _ in range(_STEPS):
        presliding_travel *= factor
        if not fits(presliding_travel):
            break
    return presliding_travel


def _direction(x: Array, presliding_travel: float, play: float) -> Array:
    out = np.empty(len(x))
    friction_directions(np.ascontiguousarray(x), 0.5 * play, presliding_travel, out)
    return out


def _explains(here: Array, without: Array) -> bool:
    """True if the residual is clearly smaller, and in every stretch as well."""
    if float(np.sum(here**2)) > (1.0 - _LEAST_SHARE) * float(np.sum(without**2)):
        return False
    edges = np.linspace(0, len(here), _STRETCHES + 1).astype(int)
    return all(
        float(np.sum(here[a:b] ** 2)) < (1.0 - 0.25 * _LEAST_SHARE) * float(np.sum(without[a:b] ** 2))
        for a, b in pairwise(edges)
    )
