"""The last minutes of a bench's signals: every sample, and the least and largest value of each stretch of samples.

A stretch is what one point of a plot shows, so that a spike of one cycle is in it, however far one looks back.
Nothing here waits for a viewer: who is slow finds what is there when he asks again, and what has gone by as stretches.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array

Weight = Literal["note", "warning", "fault", "operator"]

_KEPT: Final = 400
Values = NDArray[np.float32]

#: What is kept sample by sample, s, and how many samples at most.
_FULL_S: Final = 600.0
_MOST_SAMPLES: Final = 300_000
#: How long a stretch is, and how long stretches of that length are kept, s.
LEVELS: Final = ((0.02, 120.0), (0.2, 3600.0))


@dataclass(frozen=True)
class Entry:
    """One line: when (experiment time, s; None where it is not known), who or what it is about, what happened."""

    t_s: float | None
    source: str
    text: str
    weight: Weight = "note"


class Events:
    """Last events of a bench, by key; `number` counts changes of the list."""

    def __init__(self) -> None:
        self.number = 0
        self._entries: OrderedDict[object, tuple[int, int, Entry]] = OrderedDict()
        self._known = 0

    def put(self, key: object, entry: Entry) -> None:
        """An event, new or another than it was."""
        place, _, before = self._entries.get(key, (self._known, 0, None))
        if before == entry:
            return
        self._known += before is None
        self.number += 1
        self._entries[key] = (place, self.number, entry)
        if len(self._entries) > _KEPT:
            self._entries.popitem(last=False)

    def add(self, entry: Entry) -> None:
        """An event that stays as it is."""
        self.put(("only", self.number), entry)

    def since(self, number: int) -> list[dict[str, Any]]:
        """Events that have come or changed since the list had that number; `place` is their key."""
        return [{"place": place, **vars(entry)} for place, changed, entry in self._entries.values() if changed > number]


@dataclass(frozen=True)
class Stretches:
    """Some stretches of samples: their times, s, and the least and largest value of each signal, a row a signal."""

    first: int  #: number of the first of them, counted from the start of the history
    t_s: Array
    low: Values
    high: Values

    def __len__(self) -> int:
        return len(self.t_s)


class _Ring:
    """Rows of a time and some values, the last so many of them."""

    def __init__(self, rows: int, columns: int) -> None:
        self.count = 0  #: of all that were added
        self._t_s = np.empty(rows)
        self._values = np.empty((rows, columns), np.float32)

    def __len__(self) -> int:
        return min(self.count, len(self._t_s))

    def add(self, t_s: Array, values: Values) -> None:
        size = len(self._t_s)
        t_s, values = t_s[-size:], values[-size:]
        at = (self.count + np.arange(len(t_s))) % size
        self._t_s[at], self._values[at] = t_s, values
        self.count += len(t_s)

    def part(self, first: int, last: int) -> tuple[Array, Values]:
        at = np.arange(first, last) % len(self._t_s)
        return self._t_s[at], self._values[at]


class _Level:
    """Stretches of so many samples."""

    def __init__(self, samples: int, kept: int, columns: int) -> None:
        self.samples = samples
        self._columns = columns
        self._ring = _Ring(kept, 2 * columns)
        self._waiting: list[tuple[Array, Values]] = []
        self._waiting_rows = 0

    def add(self, t_s: Array, values: Values) -> None:
        self._waiting.append((t_s, values))
        self._waiting_rows += len(t_s)
        stretches = self._waiting_rows // self.samples
        if not stretches:
            return
        rows = stretches * self.samples
        t_s = np.concatenate([part for part, _ in self._waiting])
        values = np.concatenate([part for _, part in self._waiting])
        self._waiting, self._waiting_rows = [(t_s[rows:], values[rows:])], len(t_s) - rows
        shaped = values[:rows].reshape(stretches, self.samples, self._columns)
        least, largest = np.fmin.reduce(shaped, axis=1), np.fmax.reduce(shaped, axis=1)
        self._ring.add(t_s[: rows : self.samples], np.hstack([least, largest]))

    def since(self, number: int) -> Stretches:
        first = min(max(number, self._ring.count - len(self._ring)), self._ring.count)
        t_s, values = self._ring.part(first, self._ring.count)
        return Stretches(first, t_s, values[:, : self._columns].T, values[:, self._columns :].T)


class History:
    """Recent signals of these names. `generation` counts the runs that it has seen."""

    def __init__(self, names: Sequence[str], cycle_s: float) -> None:
        self.names = tuple(names)
        self.generation = 0
        self._cycle_s = cycle_s
        self._begin()

    def _begin(self) -> None:
        cycle_s = self._cycle_s
        self.t_s = float("nan")  #: of the last sample
        self._full = _Ring(min(round(_FULL_S / cycle_s), _MOST_SAMPLES), len(self.names))
        self._levels = [
            _Level(max(round(length_s / cycle_s), 1), round(kept_s / length_s), len(self.names))
            for length_s, kept_s in LEVELS
        ]

    def add(self, t_s: Array, values: Array) -> None:
        """More samples: times (M,) in s, and values (M, N) of the signals, SI."""
        if not len(t_s):
            return
        self.t_s = float(t_s[-1])
        single = values.astype(np.float32)
        self._full.add(t_s, single)
        for level in self._levels:
            level.add(t_s, single)

    def since(self, level: int, number: int) -> Stretches:
        """The whole stretches of one of `LEVELS` from the one with that number on, as far as they are kept."""
        return self._levels[level].since(number)

    def latest(self) -> dict[str, float | None]:
        """The value of each signal in the last sample; None where it has none."""
        if not len(self._full):
            return dict.fromkeys(self.names)
        _, values = self._full.part(self._full.count - 1, self._full.count)
        return {name: float(v) if np.isfinite(v) else None for name, v in zip(self.names, values[0], strict=True)}

    def window(self, from_s: float, to_s: float, points: int) -> Stretches:
        """Samples between two times, s: every one if there are no more than `points`, else so many stretches."""
        count = self._full.count
        t_s, values = self._full.part(count - len(self._full), count)
        first, last = np.searchsorted(t_s, [from_s, to_s])
        # A sample beyond each end, so that a line reaches the edges of a plot.
        t_s, values = t_s[max(first - 1, 0) : last + 1], values[max(first - 1, 0) : last + 1]
        if len(t_s) <= points:
            return Stretches(0, t_s, values.T, values.T)
        edges = np.linspace(0, len(t_s), points, endpoint=False).astype(int)
        return Stretches(0, t_s[edges], np.fmin.reduceat(values, edges).T, np.fmax.reduceat(values, edges).T)

    def clear(self) -> None:
        """Another run begins."""
        self.generation += 1
        self._begin()
