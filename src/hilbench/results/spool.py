"""Spool of the samples of a run to disk.

Rows go into blocks that are files mapped into memory, so that the end of the process (``kill -9``) costs none of them;
a thread writes each full block into the recording as a piece of it. So memory does not grow, and the cycle waits for no
disk unless that is some blocks behind.
"""

from __future__ import annotations

import mmap
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from math import inf
from pathlib import Path
from queue import Queue, SimpleQueue
from threading import Thread
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.errors import BenchFaultError
from hilbench.files import usable
from hilbench.results.mdf import MdfPieces, MdfWriter
from hilbench.results.recording import BLOCK_ROWS, LEAST_SAMPLES, Recording, column_of, read_rows, section_of
from hilbench.results.recording_builder import Recorder, columns_of
from hilbench.results.reduction import STRETCH_S, FullRate, Survey, thinned
from hilbench.results.run_folder import RunFolder
from hilbench.topology.signal_kinds import TIME, Signal

#: Blocks from the start on: one is filled, one waits for what follows it, one is written.
_LEAST_BLOCKS: Final = 3
#: Blocks that wait for the disk until the cycle does, too: at 2 ms, a minute and a half.
_MOST_BLOCKS: Final = 6
#: What no sample has: a NaN of its own bits. A row whose last value is that was not written.
_EMPTY: Final = 0x7FF8_6869_6C62_656E
#: Of events that follow each other more closely one is enough, s.
_EVENTS_S: Final = 1.0


class _Block:
    """Rows in a file of their own."""

    def __init__(self, path: Path, width: int) -> None:
        """Raises OSError, also where there is no space for it."""
        self.path = path
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try:
            os.posix_fallocate(file, 0, 8 * BLOCK_ROWS * width)  # a hole that can't be filled would be a SIGBUS
            self._map = mmap.mmap(file, 8 * BLOCK_ROWS * width)
        finally:
            os.close(file)
        self.rows = np.frombuffer(self._map, np.float64).reshape(BLOCK_ROWS, width)
        self.used = 0
        self.clear()

    def clear(self) -> None:
        """No row is written any more."""
        self.rows.view(np.int64)[:] = _EMPTY


class Spool(Recorder):
    """Rows of a run in its folder: `as of others, `finish` once.

    `around_events`: full rate only around what `event` and `alarms` give (times, s), and what the rows show themselves.
    `warn` is called once, where the disk takes no more; the run goes on without recording then.
    Raises UnusableInputError where the files can't be made.
    """

    def __init__(
        self,
        folder: RunFolder,
        signals: Sequence[Signal],
        started: datetime,
        comment: str,
        cycle_time_s: float,
        *,
        around_events: bool = False,
    ) -> None:
        self._folder, self._signals = folder, signals
        self._blocks: list[_Block] = []
        self._free: SimpleQueue[_Block] = SimpleQueue()
        self._waiting: Queue[_Block | None] = Queue()
        self._rows_before = 0
        self._problem, self._has_warned = "", False
        self.warn: Callable[[str], None] = lambda text: None
        self.alarms: Callable[[], Sequence[float]] = tuple
        self._times = _Times(cycle_time_s, [signal.name for signal in signals]) if around_events else None
        columns = [
            column_of(signal.name, np.dtype(np.int64 if signal.integer else np.float64), signal.unit)
            for signal in signals
        ]
        with usable(folder.unfinished_recording, "written", "space in a writable folder"):
            self._writer = MdfWriter(folder.unfinished_recording, columns, started, comment, thinned=around_events)
            super().__init__(signals)
        self._thread = Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return self._rows_before + int(self.used[0])

    def event(self, time_s: float) -> None:
        """Something happens at a time of the run: full rate around it."""
        if self._times is not None:
            self._times.add(time_s)

    def recording(self, start_time: datetime | None = None, comment: str = "") -> Recording:
        """Recording of what was recorded so far, as it is read from the folder."""
        self._waiting.join()
        if self._folder.recording.exists():
            found = read_rows(self._folder.recording)
        else:
            found = read_running(self._folder, self._signals)
        return replace(found, start_time=start_time, comment=comment)

    def finish(self) -> None:
        """Write what is left; the recording appears. Raises BenchFaultError where not all samples are in it."""
        samples = len(self)
        self._hand_over()
        self._waiting.put(None)
        self._thread.join()
        self._blocks.clear()
        try:
            if samples >= LEAST_SAMPLES:
                self._appear()
            else:
                self._folder.unfinished_recording.unlink(missing_ok=True)
        except OSError as error:
            self._problem = self._problem or _cannot_write(self._folder.recording, error)
        finally:
            self._writer.close()
            for path in self._folder.waiting_rows():
                path.unlink(missing_ok=True)
        if self._problem:
            raise BenchFaultError(self._problem)

    def _appear(self) -> None:
        try:
            os.replace(self._folder.unfinished_recording, self._folder.recording)
        except FileNotFoundError:  # somebody has removed the folder under way; the file itself is still there
            with self._writer.reader() as file, open(self._folder.recording, "wb") as copy:
                shutil.copyfileobj(file, copy)

    # -- blocks ------------------------------------------------------------------------------------------

    def _open_block(self, rows: int) -> None:
        while len(self._blocks) < (_MOST_BLOCKS if self._free.empty() else _LEAST_BLOCKS):
            path = self._folder.row_file(len(self._blocks) + 1)
            self._blocks.append(_Block(path, len(self.names)))
            self._free.put(self._blocks[-1])
        self._take_free()

    def _take_free(self) -> None:
        self._current = self._free.get()
        self.block, self.used[0] = self._current.rows, 0
        self._bytes = self.block.data.cast("B")

    def next_block(self) -> None:
        """The block is full: go on in another one."""
        self._hand_over()
        if self._problem and not self._has_warned:
            self._has_warned = True
            self.warn(f"{self._problem}; the run continues without a recording")
        try:
            self._open_block(BLOCK_ROWS)
        except OSError as error:  # no space for one more; those that are there come back
            self._problem = self._problem or _cannot_write(self._folder.recording, error)
            self._take_free()

    def _hand_over(self) -> None:
        for time_s in self.alarms():
            self.event(time_s)
        self._current.used = int(self.used[0])
        self._rows_before += self._current.used
        self.used[0] = 0
        self._waiting.put(self._current)

    # -- the thread --------------------------------------------------------------------------------------

    def _write(self) -> None:
        held: _Block | None = None  # until what follows it is known, events are around its end, too
        while True:
            block = self._waiting.get()
            if block is not None and self._times is not None:
                self._times.survey(self._columns(block))
            ready = held if self._times is not None else block
            held = block
            if ready is not None:
                self._put(ready)
            self._waiting.task_done()
            if block is None:
                return

    def _put(self, block: _Block) -> None:
        columns = self._columns(block)
        if not self._problem and block.used:
            try:
                self._writer.append(columns if self._times is None else self._times.thinned(columns))
            except OSError as error:
                self._problem = _cannot_write(self._folder.recording, error)
        block.clear()
        self._free.put(block)

    def _columns(self, block: _Block) -> dict[str, NDArray[Any]]:
        return columns_of(block.rows[: block.used], self.names, self.whole)


class _Times:
    """Times at which full rate is wanted."""

    def __init__(self, cycle_time_s: float, names: Sequence[str]) -> None:
        self._stretch = max(round(STRETCH_S / cycle_time_s), 3)
        self._survey = Survey(names)
        self._events_s: set[float] = set()

    def add(self, time_s: float) -> None:
        self._events_s.add(round(time_s / _EVENTS_S) * _EVENTS_S)

    def survey(self, columns: Mapping[str, NDArray[Any]]) -> None:
        if len(columns[TIME]):
            self._survey.take(columns)

    def thinned(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        return thinned(columns, FullRate.around((0.0, *tuple(self._events_s), *self._survey.times_s)), self._stretch)


def left_rows(folder: RunFolder, signals: Sequence[Signal], after_s: float) -> Iterator[dict[str, NDArray[Any]]]:
    """Rows that a killed run had in its blocks, of the samples after a time, in their order."""
    names, whole = [signal.name for signal in signals], [signal.integer for signal in signals]
    blocks = []
    for path in folder.waiting_rows():
        found = np.fromfile(path, np.float64)
        rows = found[: len(found) // len(names) * len(names)].reshape(-1, len(names))
        rows = rows[(rows.view(np.int64)[:, -1] != _EMPTY) & (rows[:, 0] > after_s)]
        if len(rows):
            blocks.append(rows)
    for rows in sorted(blocks, key=lambda rows: float(rows[0, 0])):
        yield columns_of(rows, names, whole)


class SpooledPieces(MdfPieces):
    """The samples of a run that goes on, or was killed: the pieces of its recording, then those that wait for it."""

    def __init__(self, folder: RunFolder, signals: Sequence[Signal]) -> None:
        while True:
            super().__init__(folder.unfinished_recording)
            last_s = -inf
            for piece in self.having([TIME]) if self.rows else ():
                last_s = float(piece[TIME][-1])
            self._left = list(left_rows(folder, signals, last_s))
            if MdfPieces(self.path).rows == self.rows:  # nothing has moved meanwhile
                break
        self.piece_rows += [len(piece[TIME]) for piece in self._left]

    def __iter__(self) -> Iterator[dict[str, NDArray[Any]]]:
        yield from super().__iter__()
        yield from self._left


def read_running(folder: RunFolder, signals: Sequence[Signal]) -> Recording:
    """The last samples, until now, of a run that goes on, as far as memory goes. Raises UnusableInputError."""
    return section_of(SpooledPieces(folder, signals), inf)


def _cannot_write(path: Path, error: OSError) -> str:
    return f"{path}: the recording cannot be written ({error.strerror})"
