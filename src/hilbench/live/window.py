"""The last minutes of a running bench: rows of all signals, by the cycle of the plant."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from hilbench.arrays import Array, Rows, runs
from hilbench.plant.sample_coherence import cycles_elapsed, play
from hilbench.results.recording import Recording
from hilbench.topology.signal_kinds import TIME

Cycles = NDArray[np.int64]

#: Signals that the drives measure; all others are commands, or the twin's.
_MEASURED: Final = re.compile(r"(x|v|tau)(\d+|_\w+?)_(m|m_s|rad|rad_s|Nm)")
_COMMAND: Final = re.compile(r"\w+_cmd_\w+")
_POSITION: Final = re.compile(r"x\d+_(m|rad)")
#: Cycles in a row up to which a smooth curve through the rows around them says what was measured.
_BRIDGED: Final = 5
#: Rows of the chunk before that such a curve goes through as well.
_BEFORE: Final = 4
#: Rows in a row that fit nowhere, after which the next one begins anew.
_MOST_ODD: Final = 100
#: Cycles in which no row came from which on they are not bridged, s.
_LONGEST_S: Final = 0.5
#: Share of the newest travel in the expected travel of a cycle.
_NEWEST: Final = 0.3


@dataclass(frozen=True)
class PlantRows:
    """Rows (n, signals) of the plant's cycles from `first` on, one each.

    `measured` (n,): whether the plant was measured in that cycle, in time; `known` (n,): that, or nearly; `syncs` (n,):
    the last SYNC until then.
    """

    first: int
    rows: Array
    measured: Rows
    known: Rows
    syncs: NDArray[np.int64]

    @property
    def end(self) -> int:
        """Cycle after the last row."""
        return self.first + len(self.rows)


class OnPlantTime:
    """Puts the samples of one run, a row for each SYNC, onto the even cycles of the plant. `names`: of the signals of a
    row.

    In real time a bench that was late leaves SYNCs out while the plant goes on, and an answer that came late is of an
    earlier SYNC. Rows of such cycles are filled in: what was commanded is held, as the drives hold it, what was
    measured is interpolated. Where that is more than a guess the rows are as good as others; longer gaps are marked.

    How many cycles the plant has gone between two rows says the bench, by the clock; where the line runs the way of the
    rollers says it better, as the drives may have taken a SYNC that was late by half a cycle for that of the next one.
    """

    def __init__(self, names: Sequence[str], cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._time = names.index(TIME)
        self._of_drives = [
            k for k, name in enumerate(names) if _MEASURED.fullmatch(name) and not _COMMAND.fullmatch(name)
        ]
        self._positions = [k for k, name in enumerate(names) if _POSITION.fullmatch(name)]
        self._plays = [play(names[k].rsplit("_", 1)[1], cycle_s) for k in self._positions]
        self._longest = round(_LONGEST_S / cycle_s)
        self._width = len(names)
        self._begin()

    def _begin(self) -> None:
        """The next row that was in time is taken as it is."""
        self._kept = np.empty((0, self._width))  # last rows, of these cycles of the plant:
        self._kept_cycles = np.empty(0, np.int64)
        self._last_row: Array | None = None  # last row, whenever it was measured
        self._more = 0  # cycles that the plant has gone, less those that the bench has counted
        self._travel: Array | None = None  # of a cycle
        self._odd = 0

    def put(self, rows: Array, cycles: Array, late: Rows, last_sync: int) -> PlantRows | None:
        """The next rows (n, signals) up to that of SYNC `last_sync`, with the plant's cycle of each as the bench counts
        it (n,), and whether an answer of a drive was not in time (n,). Returns what is known of the plant's cycles by
        now, behind that of the call before or after a gap; None: nothing more."""
        placed: list[tuple[int, int, bool]] = []  # the plant's cycle, row, whether it was measured then
        last = (int(self._kept_cycles[-1]), self._kept[-1]) if len(self._kept) else None
        for at, (outcome, is_late) in enumerate(zip(cycles.astype(int).tolist(), late.tolist(), strict=True)):
            if last is not None and (outcome + self._more - last[0] > self._longest or self._odd > _MOST_ODD):
                self._begin()
                placed, last = [], None
            cycle = None if is_late else self._place(rows[at], outcome + self._more, last)
            # At a SYNC that the drives were ahead of nothing is measured; what was commanded with it acts from then.
            new = cycle is not None and (last is None or cycle > last[0])
            self._odd = 0 if new else self._odd + 1
            placed.append((outcome + self._more if cycle is None else cycle, at, new))
            if cycle is not None:
                self._more = cycle - outcome
            if cycle is not None and new:
                last = cycle, rows[at]
        if not any(measured for _, _, measured in placed):
            return None
        return self._filled(rows, placed, last_sync + 1 - len(rows))

    def _place(self, row: Array, outcome: int, last: tuple[int, Array] | None) -> int | None:
        """The plant's cycle of a row, by the bench that of `outcome`: behind the last, or that again; None: of
        neither."""
        if last is None:
            return outcome
        travel, expected, elapsed = (row - last[1])[self._positions], self._travel, outcome - last[0]
        if expected is None:
            self._travel = travel / max(elapsed, 1)
            return outcome
        found = cycles_elapsed(travel.tolist(), expected.tolist(), self._plays, elapsed)
        if found is None or found < 0:
            return None
        if found:
            self._travel = (1.0 - _NEWEST) * expected + _NEWEST * travel / found
        return last[0] + found

    def _filled(self, rows: Array, placed: Sequence[tuple[int, int, bool]], first_sync: int) -> PlantRows:
        """Every cycle from behind those of the call before to the last that was measured."""
        cycle, at, measured = (np.array(each) for each in zip(*placed, strict=True))
        begin = int(self._kept_cycles[-1]) + 1 if len(self._kept) else int(cycle[measured][0])
        cycles = np.arange(begin, int(cycle[measured][-1]) + 1)
        in_time = np.zeros(len(cycles), bool)
        in_time[cycle[measured] - begin] = True
        given_cycles = np.concatenate([self._kept_cycles, cycle[measured]])
        given = np.vstack([self._kept, rows[at[measured]]])
        last_rows = rows[at]
        if self._last_row is not None:
            last_rows = np.vstack([self._last_row, last_rows])
            cycle, at = np.append(begin - 1, cycle), np.append(-1, at)
        # The bench's last report, in whichever row.
        held = np.searchsorted(np.maximum.accumulate(cycle), cycles, side="right") - 1
        result, syncs = last_rows[held], first_sync + at[held]
        if not np.all(in_time):
            lacking = ~in_time
            for column in self._of_drives:
                # A curve through the noise of a torque would make more of it.
                curve = _curve if column in self._positions else _straight
                result[lacking, column] = curve(given_cycles, given[:, column])(cycles[lacking])
                result[in_time, column] = given[len(self._kept) :, column]
        missed = cycles - syncs
        if np.any(missed):
            result[:, self._time] += self._cycle_s * missed
        self._last_row = rows[-1].copy()
        self._kept, self._kept_cycles = given[-_BEFORE:].copy(), given_cycles[-_BEFORE:]
        return PlantRows(begin, result, in_time, _nearly(in_time), syncs)


def _straight(at: Cycles, values: Array) -> Callable[[Cycles], Array]:
    """Linear interpolation of values."""
    return lambda places: np.interp(places, at, values)


def _curve(at: Cycles, values: Array) -> Callable[[Cycles], Array]:
    """Smoothly through all values where there are enough."""
    return make_interp_spline(at.astype(np.float64), values, k=3) if len(at) >= _BEFORE else _straight(at, values)


def _nearly(measured: Rows) -> Rows:
    """Rows that are measured, or in a gap short enough to be bridged."""
    found = measured.copy()
    for first, end in runs(~measured):
        found[first:end] = end - first <= _BRIDGED
    return found


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
        kept = (each.rows for each in self._chunks)
        return np.concatenate([np.empty((0, len(self._names))), *kept])[self._at(first, end)]

    def known(self, first: int, end: int) -> Rows:
        """(n,): whether the plant was measured in these cycles, or nearly; what the rows of others say is a guess."""
        return np.concatenate([np.empty(0, bool), *(each.known for each in self._chunks)])[self._at(first, end)]

    def measured(self, first: int, end: int) -> Rows:
        """(n,): whether the plant was measured in these cycles, by answers that came in time."""
        return np.concatenate([np.empty(0, bool), *(each.measured for each in self._chunks)])[self._at(first, end)]

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
