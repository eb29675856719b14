"""The last minutes of a running bench: rows of all signals, by the cycle of the plant."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.live.plant_rows import OnPlantTime, PlantRows
from hilbench.results.recording import Recording


class Window:
    """Rows (n, signals) of `names`, one a cycle of the plant; a gap that can't be bridged begins it anew. `most`: rows
    that are kept."""

    def __init__(self, names: Sequence[str], most: int, cycle_s: float) -> None:
        self._names = tuple(names)
        self._column = {name: k for k, name in enumerate(names)}
        self._most = most
        self._on_time = OnPlantTime(names, cycle_s)
        self._chunks: deque[PlantRows] = deque()
        self.first = 0  #: cycle of the first row
        self.end = 0  #: cycle after the last row

    def add(self, last_sync: int, content: bytes) -> None:
        """Rows up to that of a SYNC: of all signals, then the plant's cycle as the bench counts it, and whether an
        answer of a drive was not in time."""
        given = np.frombuffer(content).reshape(-1, len(self._names) + 2)
        found = self._on_time.put(given[:, :-2], given[:, -2], given[:, -1] > 0.0, last_sync)
        if found is None:
            return
        if found.first != self.end:
            self._chunks.clear()
            self.first = found.first
        self._chunks.append(found)
        self.end = found.end
        while self.end - self.first - len(self._chunks[0].rows) >= self._most:
            self.first += len(self._chunks.popleft().rows)

    def column(self, rows: Array, name: str) -> Array:
        """One signal (n,) of rows (n, signals)."""
        return rows[:, self._column[name]]

    def columns(self, rows: Array, names: Iterable[str]) -> Array:
        """(n, names): some signals of rows (n, signals)."""
        return np.column_stack([self.column(rows, name) for name in names])

    def rows(self, first: int, end: int) -> Array:
        """(n, signals): the rows of the cycles from `first` to before `end` that are kept."""
        kept = [each.rows for each in self._chunks]
        return (np.concatenate(kept) if kept else np.empty((0, len(self._names))))[self._at(first, end)]

    def known(self, first: int, end: int) -> Rows:
        """(n,): whether the plant was measured in these cycles, or nearly; what the rows of others say is a guess."""
        return self._flags([each.known for each in self._chunks], first, end)

    def measured(self, first: int, end: int) -> Rows:
        """(n,): whether the plant was measured in these cycles, by answers that came in time."""
        return self._flags([each.measured for each in self._chunks], first, end)

    def _flags(self, kept: Sequence[Rows], first: int, end: int) -> Rows:
        return (np.concatenate(kept) if kept else np.empty(0, bool))[self._at(first, end)]

    def sync(self, cycle: int) -> int:
        """Number of the last SYNC until a cycle of the plant; for one that is not kept any more, that of the first."""
        found = 0
        for chunk in self._chunks:
            if cycle < chunk.first:
                return found or int(chunk.syncs[0])
            found = int(chunk.syncs[min(cycle, chunk.end - 1) - chunk.first])
        return found

    def recording(self, first: int, end: int) -> Recording:
        """The rows as a recording."""
        rows = self.rows(first, end)
        return Recording({name: np.ascontiguousarray(rows[:, k]) for name, k in self._column.items()})

    def _at(self, first: int, end: int) -> slice:
        return slice(max(first - self.first, 0), max(end - self.first, 0))
