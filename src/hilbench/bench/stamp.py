"""Cycle numbers in a sample: count, time, bits on the bus, age of the twin's answer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.state import BenchState
from hilbench.compiled import COUNT, TABLE, entry_point, floats, integers, table_of
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.measured import BITS, CYCLES, TWIN_SYNC, twin_age_cycles

Table = NDArray[np.int64]

# Rows of the table: what is counted, the cycles from which experiment and twin count, the length of one in s, the
# sample with the places of its numbers.
_COUNTED, _BEGAN, _CYCLE_S, _VALUES, _WORDS, _AT = range(6)
_FIRST, _TWIN_STARTED = range(2)
_CYCLE_AT, _T_S_AT, _AGE_AT, _BITS_AT = range(4)
_NUMBERS = ["cycle", "t_s", "twin_age_cycles", "bus_bits"]


@entry_point(COUNT, TABLE)
def _stamp(_: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    counted, began, at = integers(table, _COUNTED, (1,)), integers(table, _BEGAN, (1,)), integers(table, _AT, (1,))
    values, words = floats(table, _VALUES, (1,)), integers(table, _WORDS, (1,))
    cycle = counted[CYCLES]
    words[at[_CYCLE_AT]] = cycle
    values[at[_T_S_AT]] = (cycle - began[_FIRST]) * floats(table, _CYCLE_S, (1,))[0]
    words[at[_AGE_AT]] = twin_age_cycles(cycle - began[_TWIN_STARTED], counted[TWIN_SYNC])
    words[at[_BITS_AT]] = counted[BITS]
    return CONTINUE


class Stamp:
    """Stamps the samples of one bench, after each exchange."""

    def __init__(self, state: BenchState, exchange: Exchange) -> None:
        self._state, sample = state, state.sample
        self._began = np.zeros(2, np.int64)
        self._at = self._began.data
        places = type(sample).places(_NUMBERS)
        kept = exchange.counted, self._began, np.array([state.cycle_s]), sample.reals, sample.wholes, places
        #: Compiled stage that stamps, by the last `begin`.
        self.piece = CompiledStage(_stamp, 0, table_of(kept), fallback=never, keeps=kept)

    def __call__(self) -> None:
        """Stamp this cycle's sample."""
        self.begin()
        self.piece()

    def begin(self) -> None:
        """Experiment and twin count from where they do now."""
        self._at[_FIRST], self._at[_TWIN_STARTED] = self._state.first_cycle, self._state.twin.started_cycle
