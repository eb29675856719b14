"""Many benches beside each other in one process."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.bench.whole_runs import config

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.twin.virtual_io import TwinStatus

COUNT = 64


@pytest.mark.slow
def test_64_benches_in_turns_do_what_one_does_alone(tmp_path: Path) -> None:
    """Their twins are in step, and state of E and tension the same bits: nothing is shared."""
    with ExitStack() as stack:
        benches = []
        for number in range(COUNT):
            folder = tmp_path / str(number)
            folder.mkdir()
            benches.append(stack.enter_context(Bench(config(folder), participants=Participants.IN_PROCESS)))
        for bench in benches:
            bench.ramp("line_speed_m_s", 1.0, 0.4)
        for _ in range(3):
            for bench in benches:
                bench.run(0.2)
        samples = [bench.cycle() for bench in benches]
        stated = {(each.E_sim_Pa, each.E_sd_Pa, each.F_sim_N, each.F_true_N, each.twin_status) for each in samples}
        synchronized = TwinStatus(int(samples[0].twin_status)) & TwinStatus.SYNCHRONIZED
    assert len(stated) == 1
    assert synchronized
