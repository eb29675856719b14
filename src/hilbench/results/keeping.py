"""Samples kept for the recording, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.task import CompiledStages
from hilbench.compiled import COUNT, TABLE, entry_point, integers, table_of
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.results.recording_builder import RecordingBuilder
from hilbench.topology.sample import CycleSample


#: keep(0, table of a sample as whole numbers, block (n, m) of rows as such, how many of them are used (1,)).
@entry_point(COUNT, TABLE)
def _keep(_: int, table: NDArray[np.int64]) -> int:
    if len(table) == 0:
        return CONTINUE
    words, block, used = integers(table, 0, (1,)), integers(table, 1, (1, 2)), integers(table, 2, (1,))
    at = used[0]
    for k in range(block.shape[1]):
        block[at, k] = words[k]
    used[0] = at + 1
    return CONTINUE


class Keeping:
    """Puts samples into what a `RecordingBuilder` has room for."""

    def __init__(self, builder: RecordingBuilder) -> None:
        self._builder = builder

    def pieces(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages of a cycle with this sample. The next block is Python's."""
        builder, of = self._builder, self._builder.block
        kept = [sample.wholes, of.view(np.int64), builder.used]
        table = table_of(kept)

        def cycles() -> int:
            nonlocal of
            if of is not builder.block:
                of = builder.block
                kept[1] = of.view(np.int64)
                table[:] = table_of(kept)
            return len(of) - int(builder.used[0])

        return CompiledStages(after=[CompiledStage(_keep, 0, kept, fallback=never, table=table)], cycles=cycles)
