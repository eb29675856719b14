"""Planned set points of a machine, as far as they are known: quantities by path, over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from hilbench.arrays import Array


@dataclass(frozen=True, slots=True)
class Move:
    """Change of a quantity (`hilbench.topology.quantities`, SI) to a value: linear from `start_s` to `end_s`, or a step
    where these are equal. Times are experiment time, s."""

    path: str
    start_s: float
    end_s: float
    to: float


@dataclass(frozen=True)
class Plan:
    """Planned moves in order of their start; after its last one a quantity is constant."""

    moves: tuple[Move, ...] = ()

    def course(self, path: str, present: float, now_s: float, times_s: Array) -> Array:
        """Course of the quantity at `times_s` (n,), rising, none before `now_s`, where it is `present`."""
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
        """Plan with other moves in place of all of their paths."""
        given = tuple(moves)
        paths = {move.path for move in given}
        return Plan((*(move for move in self.moves if move.path not in paths), *given))


@dataclass(frozen=True)
class Asked:
    """Set points of a machine now (`present`, by path), and planned; `ceilings`: limits of their size, whatever the set
    points."""

    present: Mapping[str, float] = field(default_factory=dict)
    plan: Plan = Plan()
    ceilings: Mapping[str, float] = field(default_factory=dict)

    def course(self, path: str, fallback: float, now_s: float, times_s: Array) -> Array:
        """Course of a set point as `Plan.course`; `fallback`: the present value where it is not given."""
        course = self.plan.course(path, self.present.get(path, fallback), now_s, times_s)
        ceiling = self.ceilings.get(path)
        return course if ceiling is None else np.clip(course, -ceiling, ceiling)
