"""Evaluation of a future's quantities: course, and probability of staying below their levels, measured with noise;
compiled."""

from __future__ import annotations

from math import erfc, sqrt
from typing import Final, NamedTuple

from hilbench.compiled import Reals, Reals2, Reals3, Vector, Wholes2, compiled, inlined, noinline

#: Distance from a level, in standard deviations of the noise, beyond which no crossing is assumed.
FARTHEST: Final = 6.0
#: Step of a crossing that does not occur.
NEVER: Final = -2
_ROOT_2: Final = sqrt(2.0)


class TallyVectors(NamedTuple):
    """Result vectors of B futures of Q quantities, and the settings of their evaluation, for compiled callers."""

    offset: Reals2  #: (B, Q): added to a future's quantities
    noise: Reals  #: (Q,): of the measurement
    levels: Reals2  #: (Q, 2): warning and trip
    survival: Reals2  #: (B, 2 Q): probabilities that a level was not crossed
    first: Wholes2  #: (B, 2 Q): first step at which a crossing is more likely than not, `NEVER` before
    largest: Reals2  #: (B, Q)
    rows: Reals3  #: (R, B, Q): recorded courses
    nearest: Reals  #: (Q,): sizes up to which no level is within reach of the noise


@inlined
def see(v: TallyVectors, q: Vector, samples: float, b: int, i: int) -> None:
    """Evaluate quantities q (Q,) of future b at the end of step i, measured `samples` times in it: largest sizes, and
    probability of staying below the levels."""
    for j in range(q.shape[0]):
        size = abs(q[j] + v.offset[b, j])
        v.largest[b, j] = max(v.largest[b, j], size)
        if size > v.nearest[j]:
            _judge_levels(v, size, samples, b, j, i)


@compiled
def _judge_levels(v: TallyVectors, size: float, samples: float, b: int, j: int, i: int) -> None:
    """Update the probabilities that quantity j stayed below its levels by a step with this size, which is near one, and
    so many measurements."""
    noinline()
    for level in range(2):
        limit, at, sigma = v.levels[j, level], 2 * j + level, v.noise[j]
        if sigma == 0.0 and size > limit:
            v.survival[b, at] = 0.0
        elif sigma != 0.0 and (limit - size) / sigma < FARTHEST:
            v.survival[b, at] *= (1.0 - 0.5 * erfc((limit - size) / sigma / _ROOT_2)) ** samples
        if v.survival[b, at] < 0.5 and v.first[b, at] == NEVER:
            v.first[b, at] = i


@inlined
def keep(v: TallyVectors, q: Vector, b: int, row: int) -> None:
    """Record a row of the course."""
    for j in range(q.shape[0]):
        v.rows[row, b, j] = q[j] + v.offset[b, j]
