"""A recording while it is made: a row a cycle."""

from __future__ import annotations

import struct
from collections.abc import Container, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.task import CompiledStages
from hilbench.compiled import COUNT, TABLE, Wholes, Wholes2, arrays_in, entry_point, table_of
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.results.recording import BLOCK_ROWS, Recording, typed
from hilbench.topology.sample import CycleSample
from hilbench.topology.signal_kinds import TIME, Signal


class _Kept(NamedTuple):
    """A sample, a block of rows (n, m), and how many of them are used (1,)."""

    words: Wholes
    block: Wholes2
    used: Wholes


@entry_point(COUNT, TABLE)
def _keep(_: int, table: NDArray[np.int64]) -> int:
    if len(table) == 0:
        return CONTINUE
    kept = arrays_in(table, _Kept)
    at = kept.used[0]
    for k in range(kept.block.shape[1]):
        kept.block[at, k] = kept.words[k]
    kept.used[0] = at + 1
    return CONTINUE


class RecordingBuilder:
    """Observer of cycles that collects one row each, cheaply and without ever copying what is there.

    `names` are the channels in the order of a row; the first must be ``t_s``. Those that are `whole` are int64 in a
    row, the others binary64. `expected_rows` are allocated and touched at once, so that a run of that length allocates
    nothing; a longer run goes on in further blocks.
    """

    def __init__(self, names: Sequence[str], expected_rows: int = BLOCK_ROWS, whole: Container[str] = ()) -> None:
        if not names or names[0] != TIME or len(set(names)) != len(names):
            raise ValueError(f"channels {list(names)}: expected distinct names, {TIME} first")
        self.names = tuple(names)
        self.whole = [name in whole for name in names]  #: by name
        self._row = struct.Struct("=" + "".join("q" if is_whole else "d" for is_whole in self.whole))
        self._row_size = self._row.size
        self._of: CycleSample | None = None  # the sample whose bytes are below
        self._sample_bytes = memoryview(b"")
        self._full: list[NDArray[np.float64]] = []
        self.used = np.zeros(1, np.int64)  #: rows of the block
        self._at = self.used.data  # one value goes faster through this
        self._open_block(max(expected_rows, 1))

    def _open_block(self, rows: int) -> None:
        self.block = np.full((rows, len(self.names)), np.nan)  #: of rows: those so far, and room for more
        self._bytes = self.block.data.cast("B")
        self.used[0] = 0

    def append(self, row: Sequence[float]) -> None:
        """Add one sample: a value per channel. Raises struct.error if the row has another length."""
        at = self._next_row()
        self._row.pack_into(self._bytes, at, *row)
        self._at[0] += 1

    def append_packed(self, row: memoryview) -> None:
        """Append a row that is in memory already, as bytes. Raises ValueError if it has another length."""
        at = self._next_row()
        self._bytes[at : at + self._row_size] = row
        self._at[0] += 1

    def sample(self, sample: CycleSample) -> None:
        """Keep one cycle."""
        if sample is not self._of:
            self._of, self._sample_bytes = sample, sample.reals.data[: len(self.names)].cast("B")
        self.append_packed(self._sample_bytes)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages that keep a cycle with this sample. The next block is Python's."""
        of = self.block
        kept = _Kept(sample.wholes, of.view(np.int64), self.used)
        table = table_of(kept)

        def cycles() -> int:
            nonlocal of, kept
            if of is not self.block:
                of = self.block
                kept = kept._replace(block=of.view(np.int64))
                table[:] = table_of(kept)
            return len(of) - int(self.used[0])

        return CompiledStages(after=[CompiledStage(_keep, 0, kept, fallback=never, table=table)], cycles=cycles)

    def _next_row(self) -> int:
        """Offset of the next row in the bytes of the block."""
        if self._at[0] == len(self.block):
            self.next_block()
        return self._at[0] * self._row_size

    def next_block(self) -> None:
        """The block is full: go on in another one."""
        self._full.append(self.block)
        self._open_block(BLOCK_ROWS)

    def __len__(self) -> int:
        """Number of samples so far."""
        return sum(map(len, self._full)) + self._at[0]

    def recording(self, start_time: datetime | None = None, comment: str = "") -> Recording:
        """Recording of what was recorded so far, as a copy; counts and bit fields become integers where every
        sample is one."""
        rows = np.concatenate([*self._full, self.block[: self._at[0]]])
        columns = columns_of(rows, self.names, self.whole)
        channels = {name: typed(name, np.ascontiguousarray(each, np.float64)) for name, each in columns.items()}
        return Recording(channels, start_time, comment)


def columns_of(rows: NDArray[np.float64], names: Sequence[str], whole: Sequence[bool]) -> dict[str, NDArray[Any]]:
    """Channels of rows (n, m), whose whole ones are int64."""
    integers = rows.view(np.int64)
    return {
        name: (integers if is_whole else rows)[:, at]
        for at, (name, is_whole) in enumerate(zip(names, whole, strict=True))
    }


class Recorder(RecordingBuilder):
    """Keeps every sample of a bench with these signals."""

    def __init__(self, signals: Sequence[Signal]) -> None:
        names, whole = [signal.name for signal in signals], {signal.name for signal in signals if signal.integer}
        super().__init__(names, whole=whole)
