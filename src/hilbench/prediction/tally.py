"""What futures are counted in while they run, and the outlook that comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from hilbench.prediction.judging import NEVER
from hilbench.prediction.outlook import Outlook, Watched

Array = NDArray[np.float64]

#: Longest step of a future, s, and the largest share of the fastest motion's time (1/ω) that one may be.
_LONGEST_STEP_S: Final = 0.00625
_SHARE_OF_FASTEST: Final = 0.6
#: A row of a course is kept every so often, s.
_ROW_S: Final = 0.05


@dataclass(frozen=True)
class Offsets:
    """How what is measured differs from what the futures say, by quantity (Q,): lastingly, with the deviation of that,
    and the noise of one measured sample; in the unit of the quantity."""

    lasting: Array
    lasting_sd: Array
    noise: Array

    @classmethod
    def none(cls, quantities: int) -> Self:
        """Measured without noise, and as the futures say."""
        return cls(np.zeros(quantities), np.zeros(quantities), np.zeros(quantities))


@dataclass(frozen=True)
class Tally:
    """Of B futures and Q quantities, as `judging.see` and the kernels of the machines fill it: probabilities (B, 2 Q)
    that a level was not crossed, the steps of the crossings (B, 2 Q), largest sizes (B, Q), and R rows (R, B, Q)."""

    watched: tuple[Watched, ...]
    survival: Array
    first: NDArray[np.int64]
    largest: Array
    rows: Array

    @classmethod
    def of(cls, watched: tuple[Watched, ...], futures: int, rows: int) -> Self:
        """Before the first step."""
        q = len(watched)
        survival, first = np.ones((futures, 2 * q)), np.full((futures, 2 * q), NEVER, np.int64)
        return cls(watched, survival, first, np.zeros((futures, q)), np.zeros((rows, futures, q)))

    def outlook(self, now_s: float, step_s: float, every: int) -> Outlook:
        """Of futures that have run from `now_s` on in steps of `step_s`, a row kept every so many."""
        (b, q), first = self.largest.shape, self.first
        crossed: Array = np.where(first > NEVER, now_s + (first + 1) * step_s, np.nan)
        return Outlook(
            now_s,
            self.watched,
            np.asarray(now_s + step_s * every * np.arange(1, len(self.rows) + 1), np.float64),
            self.rows,
            self.largest,
            (1.0 - self.survival.mean(axis=0)).reshape(q, 2),
            crossed.reshape(b, q, 2),
        )


def whole_step_s(fastest_per_s: float, horizon_s: float) -> float:
    """The step of futures: as long as the fastest motion allows, and a whole part of the horizon."""
    longest_s = min(_LONGEST_STEP_S, _SHARE_OF_FASTEST / fastest_per_s if fastest_per_s else _LONGEST_STEP_S)
    return horizon_s / ceil(horizon_s / longest_s)


def row_every(step_s: float) -> int:
    """A row of a course is kept every so many steps."""
    return max(1, round(_ROW_S / step_s))


def levels_of(watched: Sequence[Watched]) -> Array:
    """Warning and trip level of each (Q, 2); infinite where there is none."""
    return np.array([(each.warning or np.inf, each.trip or np.inf) for each in watched], float).reshape(-1, 2)
