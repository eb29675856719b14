"""The last minutes of a running bench: rows of all signals, by the number of their cycle."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hilbench.results.recording import Recording

Array = NDArray[np.float64]


class Window:
    """Rows (n, signals) of `names`, one a cycle without a gap; a gap begins it anew. `most`: rows that are kept."""

    def __init__(self, names: Sequence[str], most: int) -> None:
        self._names = tuple(names)
        self._column = {name: k for k, name in enumerate(names)}
        self._most = most
        self._chunks: deque[Array] = deque()
        self.first = 0  #: cycle of the first row
        self.end = 0  #: cycle after the last row

    def add(self, last_cycle: int, content: bytes) -> Array:
        """Rows up to and with a cycle; returns them (n, signals)."""
        rows = np.frombuffer(content).reshape(-1, len(self._names))
        begin = last_cycle + 1 - len(rows)
        if begin != self.end:
            self._chunks.clear()
            self.first = begin
        self._chunks.append(rows)
        self.end = last_cycle + 1
        while self.end - self.first - len(self._chunks[0]) >= self._most:
            self.first += len(self._chunks.popleft())
        return rows

    def column(self, rows: Array, name: str) -> Array:
        """Of rows (n, signals) one signal (n,)."""
        return rows[:, self._column[name]]

    def rows(self, first: int, end: int) -> Array:
        """(n, signals): the rows of the cycles from `first` to before `end` that are kept."""
        kept = np.concatenate(list(self._chunks)) if self._chunks else np.empty((0, len(self._names)))
        return kept[max(first - self.first, 0) : max(end - self.first, 0)]

    def recording(self, first: int, end: int) -> Recording:
        """The same as a recording."""
        rows = self.rows(first, end)
        return Recording({name: np.ascontiguousarray(rows[:, k]) for name, k in self._column.items()})
