"""Base of all machines' futures: a prediction from the present estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil
from statistics import NormalDist
from typing import Final, Generic, Self, TypeVar

import numpy as np

from hilbench.arrays import Array
from hilbench.prediction.judging import FARTHEST, NEVER, TallyVectors
from hilbench.prediction.outlook import Outlook, WatchedQuantity


def normal_draws(futures: int, quantities: int, *key: int) -> Array:
    """Standard normal numbers (futures, quantities), the same for the same key.

    A Latin hypercube: each quantity has one number out of each of so many equally probable parts (McKay, Beckman,
    Conover, Technometrics 21(2), 1979), so that a mean or a share of few futures is nearer to that of very many.
    """
    random = np.random.default_rng(key)
    quantiles = _quantiles(futures)
    return np.stack([random.permutation(quantiles) for _ in range(quantities)], axis=1)


@cache
def _quantiles(count: int) -> Array:
    normal = NormalDist()
    return np.array([normal.inv_cdf((place + 0.5) / count) for place in range(count)])


#: Longest step, as a share of the fastest motion's time (1/ω).
_SHARE_OF_FASTEST: Final = 0.6
#: Interval of recorded rows of a course, s.
_ROW_S: Final = 0.05


@dataclass(frozen=True)
class Offsets:
    """Difference of measurements from the futures, by quantity (Q,): lasting offset, its deviation, and the noise of
    one measured sample; in the unit of the quantity."""

    lasting: Array
    lasting_sd: Array
    noise: Array


@dataclass(frozen=True)
class Tally:
    """Tally of B futures and Q quantities, filled by the machines' kernels in T steps of `step_s`; a row of the courses
    is recorded every `every` steps."""

    watched: tuple[WatchedQuantity, ...]
    step_s: float
    every: int
    vectors: TallyVectors

    @classmethod
    def of(cls, watched: tuple[WatchedQuantity, ...], offsets: Offsets, z: Array, step_s: float, steps: int) -> Self:
        """Tally before the first step; z (B, Q): draws of the lasting offsets."""
        (b, q), every = z.shape, max(1, round(_ROW_S / step_s))
        # Warning and trip level of each (Q, 2); infinite where there is none.
        levels = np.array([(each.warning or np.inf, each.trip or np.inf) for each in watched], float).reshape(-1, 2)
        vectors = TallyVectors(
            offset=np.ascontiguousarray(offsets.lasting + offsets.lasting_sd * z),
            noise=np.ascontiguousarray(offsets.noise),
            levels=levels,
            survival=np.ones((b, 2 * q)),
            first=np.full((b, 2 * q), NEVER, np.int64),
            largest=np.zeros((b, q)),
            rows=np.zeros((steps // every, b, q)),
            nearest=np.asarray(levels.min(axis=1) - FARTHEST * offsets.noise, np.float64),
        )
        return cls(watched, step_s, every, vectors)

    def outlook(self, now_s: float) -> Outlook:
        """Outlook of futures that have run from `now_s` on."""
        v = self.vectors
        crossed: Array = np.where(v.first > NEVER, now_s + (v.first + 1) * self.step_s, np.nan)
        times_s = np.asarray(now_s + self.step_s * self.every * np.arange(1, len(v.rows) + 1), np.float64)
        probability = (1.0 - v.survival.mean(axis=0)).reshape(-1, 2)
        first_s = crossed.reshape(*v.largest.shape, 2)
        return Outlook(now_s, self.watched, times_s, v.rows, v.largest, probability, first_s, v.noise)


def whole_step_s(fastest_per_s: float, horizon_s: float, most_s: float) -> float:
    """Step of futures: as long as the fastest motion allows, `most_s` at most, and a whole part of the horizon."""
    longest_s = min(most_s, _SHARE_OF_FASTEST / fastest_per_s if fastest_per_s else most_s)
    return horizon_s / ceil(horizon_s / longest_s)


#: A prediction: the simulation, which takes its time and releases the GIL, and the function of its result.
Prepared = tuple[Callable[[], None], Callable[[], Outlook]]
Present = TypeVar("Present")
Courses = TypeVar("Courses")


class Futures(ABC, Generic[Present, Courses]):
    """Futures of one machine, drawn and simulated; `watched`: its quantities, Q, in the order of its kernel.

    `Present`: its present estimate; `Courses`: its future set points.
    """

    def __init__(self, watched: Sequence[WatchedQuantity]) -> None:
        self.watched = tuple(watched)

    @property
    def quantities(self) -> int:
        """Number of quantities, Q."""
        return len(self.watched)

    @abstractmethod
    def prepare(self, present: Present, courses: Courses, offsets: Offsets, *key: int) -> Prepared:
        """Prepare a prediction. `key`: seed of all draws; equal arguments give an equal outlook."""

    @abstractmethod
    def at_rest(self) -> tuple[Present, Courses]:
        """Present and courses of a machine at rest that stays at rest."""

    def look(self, present: Present, courses: Courses, offsets: Offsets, *key: int) -> Outlook:
        """Run a prediction in one call."""
        run, outlook = self.prepare(present, courses, offsets, *key)
        run()
        return outlook()

    def no_offsets(self) -> Offsets:
        """Offsets of measurements without noise and without deviation from the futures."""
        return Offsets(*np.zeros((3, self.quantities)))

    def warm_up(self) -> None:
        """Compile, or load, the functions of a prediction."""
        self.look(*self.at_rest(), self.no_offsets())
