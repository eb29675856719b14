"""Samples kept for the recording, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.task import CompiledStages
from hilbench.compiled import COUNT, TABLE, Wholes, Wholes2, arrays_in, entry_point, table_of
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.results.recording_builder import RecordingBuilder
from hilbench.topology.sample import CycleSample


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


class Keeping:
    """Puts samples into what a `RecordingBuilder` has room for."""

    def __init__(self, builder: RecordingBuilder) -> None:
        self._builder = builder

    def pieces(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages of a cycle with this sample. The next block is Python's."""
        builder, of = self._builder, self._builder.block
        kept = _Kept(sample.wholes, of.view(np.int64), builder.used)
        table = table_of(kept)

        def cycles() -> int:
            nonlocal of, kept
            if of is not builder.block:
                of = builder.block
                kept = kept._replace(block=of.view(np.int64))
                table[:] = table_of(kept)
            return len(of) - int(builder.used[0])

        return CompiledStages(after=[CompiledStage(_keep, 0, kept, fallback=never, table=table)], cycles=cycles)
