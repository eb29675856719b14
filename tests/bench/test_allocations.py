"""What a cycle allocates it gives back: nothing grows, and nothing is left to the garbage collector, which is off."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path

import pytest
from tests.bench.whole_runs import config

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.runs.config import load_with_overrides

_CYCLES = 400


def _cycles(bench: Bench) -> None:
    for _ in range(_CYCLES):
        bench.cycle()


@pytest.mark.slow
def test_cycles_leave_neither_memory_nor_garbage_behind(tmp_path: Path) -> None:
    loaded = load_with_overrides(config(tmp_path))
    with Bench(loaded.config, participants=Participants.IN_PROCESS):
        pass  # what has to be compiled is now: traced, that takes minutes
    tracemalloc.start()  # before caches fill: what takes the place of something there is no growth
    with Bench(loaded.config, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 1.0, 0.2)
        bench.run(2.0)  # windows and caches fill
        assert not gc.isenabled()
        gc.collect()  # which empties the interpreter's free lists as well: they fill again first
        bench.run(4.0)
        _cycles(bench)  # one by one they have windows of their own
        before = tracemalloc.get_traced_memory()[0]
        _cycles(bench)
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        garbage = gc.collect()
    assert garbage < 50
    # A tenth of a float a cycle: nothing that a cycle makes stays.
    assert grown < 2.4 * _CYCLES
    assert gc.isenabled()
