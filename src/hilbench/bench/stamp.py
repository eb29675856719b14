"""Cycle numbers in a sample: count, time, bits on the bus, age of the twin's answer."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.state import BenchState
from hilbench.compiled import COUNT, TABLE, Reals, Wholes, Wholes2, arrays_in, entry_point, load, record_type
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.measured import COUNTED, twin_age_cycles

#: The cycles from which experiment and twin count.
_BEGAN = record_type("experiment", "twin", of=np.int64)
_AT = record_type("cycle", "t_s", "twin_age_cycles", "bus_bits", of=np.int64)


class _Arrays(NamedTuple):
    """What is counted, from where, the length of a cycle in s (1,), and the sample with the places of its numbers."""

    counted: Annotated[Any, COUNTED]
    began: Annotated[Any, _BEGAN]
    cycle_s: Reals
    values: Reals
    words: Wholes
    at: Annotated[Any, _AT]


@entry_point(COUNT, TABLE)
def _stamp(_: int, table: Wholes2) -> int:
    a = arrays_in(table, _Arrays)
    cycle = a.counted.cycles
    a.words[a.at.cycle] = cycle
    a.values[a.at.t_s] = (cycle - a.began.experiment) * a.cycle_s[0]
    a.words[a.at.twin_age_cycles] = twin_age_cycles(cycle - a.began.twin, a.counted.twin_sync)
    a.words[a.at.bus_bits] = a.counted.bits
    return CONTINUE


class Stamp:
    """Stamps the samples of one bench, after each exchange."""

    def __init__(self, state: BenchState, exchange: Exchange) -> None:
        load(_stamp)
        self._state, sample = state, state.sample
        self._began = np.zeros(1, _BEGAN)
        arrays = _Arrays(
            *(exchange.counted, self._began, np.array([state.cycle_s]), sample.reals, sample.wholes),
            type(sample).places(list(_AT.names or ())),
        )
        #: Compiled stage that stamps, by the last `begin`.
        self.piece = CompiledStage(_stamp, 0, arrays, fallback=never)

    def __call__(self) -> None:
        """Stamp this cycle's sample."""
        self.begin()
        self.piece()

    def begin(self) -> None:
        """Experiment and twin count from where they do now."""
        self._began[0] = self._state.first_cycle, self._state.twin.started_cycle
