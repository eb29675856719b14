"""Whether a future stays below the levels of its quantities, while each is measured with noise; compiled."""

from __future__ import annotations

from math import erfc, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled, inlined

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Noise further from a level than so many standard deviations never carries a quantity beyond it.
_FARTHEST: Final = 6.0
#: The step of a crossing that does not come.
NEVER: Final = -2
_ROOT_2: Final = sqrt(2.0)


@inlined
def _judge(
    size: float, level: float, sigma: float, samples: float, survival: Matrix, first: Indices, b: int, at: int, i: int
) -> None:
    """What a step with a quantity of this size does to the probability that it stayed below a level.

    sigma: of the noise with which it is measured, `samples` times in a step.
    """
    if sigma == 0.0:
        if size > level:
            survival[b, at] = 0.0
    else:
        away = (level - size) / sigma
        if away < _FARTHEST:
            survival[b, at] *= (1.0 - 0.5 * erfc(away / _ROOT_2)) ** samples
    if survival[b, at] < 0.5 and first[b, at] == NEVER:
        first[b, at] = i


@compiled
def see(
    q: Vector,
    offset: Matrix,
    sigma: Vector,
    levels: Matrix,
    samples: float,
    b: int,
    i: int,
    survival: Matrix,
    first: Indices,
    worst: Matrix,
) -> None:
    """Quantities q (Q,) of future b at the end of step i: its largest sizes into `worst` (B, Q), and what
    that does to the probability that it stays below the levels (Q, 2): `survival` (B, 2 Q).

    offset (B, Q) is added to q; sigma (Q,) and `samples` as in `_judge`; `first` (B, 2 Q): the step from which a level
    is crossed more likely than not, `NEVER` before.
    """
    for j in range(q.shape[0]):
        size = abs(q[j] + offset[b, j])
        worst[b, j] = max(worst[b, j], size)
        for level in range(2):
            if levels[j, level] < np.inf:
                _judge(size, levels[j, level], sigma[j], samples, survival, first, b, 2 * j + level, i)
