"""Evaluation of a future's quantities: course, and probability of staying below their levels, measured with noise;
compiled."""

from __future__ import annotations

from math import erfc, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled, floats, inlined, integers, merged, noinline

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Cube = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Distance from a level, in standard deviations of the noise, beyond which no crossing is assumed.
FARTHEST: Final = 6.0
#: Step of a crossing that does not occur.
NEVER: Final = -2
_ROOT_2: Final = sqrt(2.0)


@inlined
def _judge(
    size: float, level: float, sigma: float, samples: float, survival: Matrix, first: Indices, b: int, at: int, i: int
) -> None:
    """Update the probability that a quantity stayed below a level by a step with this size.

    sigma: of the measurement noise, `samples` measurements per step.
    """
    if sigma == 0.0:
        if size > level:
            survival[b, at] = 0.0
    else:
        away = (level - size) / sigma
        if away < FARTHEST:
            survival[b, at] *= (1.0 - 0.5 * erfc(away / _ROOT_2)) ** samples
    if survival[b, at] < 0.5 and first[b, at] == NEVER:
        first[b, at] = i


class TallyVectors(NamedTuple):
    """Result vectors of B futures of Q quantities, and the settings of their evaluation, for compiled callers."""

    offset: Matrix  #: (B, Q): added to a future's quantities
    noise: Vector  #: (Q,): of the measurement
    levels: Matrix  #: (Q, 2): warning and trip
    survival: Matrix  #: (B, 2 Q): probabilities that a level was not crossed
    first: Indices  #: (B, 2 Q): first step at which a crossing is more likely than not, `NEVER` before
    largest: Matrix  #: (B, Q)
    rows: Cube  #: (R, B, Q): recorded courses
    nearest: Vector  #: (Q,): sizes up to which no level is within reach of the noise


@merged
def of_table(table: Indices) -> TallyVectors:
    """Vectors in a `table_of` them."""
    return TallyVectors(
        floats(table, 0, (1, 2)),
        floats(table, 1, (1,)),
        floats(table, 2, (1, 2)),
        floats(table, 3, (1, 2)),
        integers(table, 4, (1, 2)),
        floats(table, 5, (1, 2)),
        floats(table, 6, (1, 2, 3)),
        floats(table, 7, (1,)),
    )


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
    """Evaluate quantity j with this size, which is near a level."""
    noinline()
    for level in range(2):
        if v.levels[j, level] < np.inf:
            _judge(size, v.levels[j, level], v.noise[j], samples, v.survival, v.first, b, 2 * j + level, i)


@inlined
def keep(v: TallyVectors, q: Vector, b: int, row: int) -> None:
    """Record a row of the course."""
    for j in range(q.shape[0]):
        v.rows[row, b, j] = q[j] + v.offset[b, j]
