"""What is going to be asked of a machine, as far as it is known now: quantities by path, over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Move:
    """A quantity (`hilbench.topology.quantities`, SI) goes to a value: linearly from `start_s` to `end_s`, or at once
    where these are one. Times are experiment time, s."""

    path: str
    start_s: float
    end_s: float
    to: float


@dataclass(frozen=True)
class Plan:
    """Moves in the order in which they begin; beyond the last one of a quantity it stays what it is."""

    moves: tuple[Move, ...] = ()

    def course(self, path: str, present: float, now_s: float, times_s: Array) -> Array:
        """The quantity at `times_s` (n,), rising, none before `now_s`, at which it is `present`."""
        values = np.full(len(times_s), present)
        value = present
        for move in self.moves:
            if move.path != path or move.end_s < now_s:
                continue
            begin = max(move.start_s, now_s)
            values[times_s >= move.end_s] = move.to
            under_way = (times_s > begin) & (times_s < move.end_s)
            if under_way.any():
                share = (times_s[under_way] - begin) / (move.end_s - begin)
                values[under_way] = value + (move.to - value) * share
            value = move.to
        return values

    def with_moves(self, moves: Iterable[Move]) -> Plan:
        """The same with other moves in place of all of their paths."""
        given = tuple(moves)
        paths = {move.path for move in given}
        return Plan((*(move for move in self.moves if move.path not in paths), *given))


@dataclass(frozen=True)
class Asked:
    """What is asked of a machine now (`present`, by path), and what is going to be; `ceilings`: sizes that something is
    held below, whatever is asked for."""

    present: Mapping[str, float] = field(default_factory=dict)
    plan: Plan = Plan()
    ceilings: Mapping[str, float] = field(default_factory=dict)

    def course(self, path: str, fallback: float, now_s: float, times_s: Array) -> Array:
        """As `Plan.course`; `fallback`: the present value where it is not given."""
        course = self.plan.course(path, self.present.get(path, fallback), now_s, times_s)
        ceiling = self.ceilings.get(path)
        return course if ceiling is None else np.clip(course, -ceiling, ceiling)
