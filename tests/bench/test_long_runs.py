"""Runs that go on: what they hold does not grow, and what they leave is as good as that of a short one."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import SHORT, config

from hilbench.apps.report.html import write_report
from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.results.trace import TraceReader, parts_of
from hilbench.runs.config import load_with_overrides

#: Counts per turn of a motor (608Fh of its EDS file), and turns per metre of web.
COUNTS, TURNS_PER_M = 1 << 20, 5.0 / (2.0 * np.pi * 0.2)


@pytest.mark.slow
def test_memory_of_a_run_does_not_grow_and_its_counters_may_wrap(tmp_path: Path) -> None:
    path = config(tmp_path, trace={"part_MB": 30.0, "compress": True})
    tracemalloc.start()
    with Bench(path, participants=Participants.IN_PROCESS, out=tmp_path / "runs") as bench:
        bench.ramp("line_speed_m_s", 3.0, 2.0)
        bench.run(40.0)
        before = tracemalloc.get_traced_memory()[0]
        bench.run(150.0)
        grown = tracemalloc.get_traced_memory()[0] - before
        bench.ramp("line_speed_m_s", 0.0, 2.0)
        assert len(bench.recording) == 97_000
    tracemalloc.stop()
    folder = bench.folder
    assert folder is not None
    found = read_recording(folder.recording)
    assert grown < 0.1 * 75_000 * 8 * len(found.channels)
    assert found["x2_m"][-1] * TURNS_PER_M * COUNTS > 2**31  # the drive's position has 32 bits, and has wrapped
    assert -1e-4 < np.min(np.diff(found["x2_m"])) < np.max(np.diff(found["x2_m"])) < 6.3e-3  # m in 2 ms at 3 m/s
    assert len(found) > 1 << 16  # the twin counts SYNCs in 16 bits
    assert np.max(found["twin_age_cycles"]) <= 1
    assert len(parts_of(folder.trace)) == 2
    syncs = sum(frame.can_id == 0x80 for frame in TraceReader(folder.trace))
    assert syncs > len(found)


def run(folder: Path, full_rate: str) -> RunOutcome:
    steps = [*SHORT[:3], {"hold": {"duration_s": 40.0}}, {"step": {"path": "tension_control.set_point_N", "to": 90.0}}]
    folder.mkdir()
    path = config(folder, steps=[*steps, {"hold": {"duration_s": 60.0}}], recording={"full_rate": full_rate})
    return run_experiment(load_with_overrides(path), folder / "runs", participants=Participants.IN_PROCESS)


def test_full_rate_around_events_gives_the_figures_of_all_samples_and_a_smaller_file(tmp_path: Path) -> None:
    whole, short = (run(tmp_path / each, each) for each in ("always", "around_events"))
    recordings = [read_recording(outcome.folder.recording) for outcome in (whole, short)]
    assert len(recordings[1]) < 0.6 * len(recordings[0])
    assert short.result.timing.cycles == whole.result.timing.cycles == len(recordings[0])
    for one, other in zip(whole.result.steps or [], short.result.steps or [], strict=True):
        assert one.figures.keys() == other.figures.keys()
        for name in ("E_time_to_1pct_s", "E_noise_pct", "E_final_error_pct", "tension_recovery_s"):
            if name in one.figures:
                assert other.figures[name] == pytest.approx(one.figures[name], rel=1e-6), name
    for name in ("F_true_N", "E_sim_Pa", "tau2_Nm"):
        assert recordings[1][name].min() == recordings[0][name].min()
        assert recordings[1][name].max() == recordings[0][name].max()


def test_a_trace_that_has_its_size_ends_with_a_notice_and_the_run_goes_on(tmp_path: Path) -> None:
    loaded = load_with_overrides(config(tmp_path, trace={"keep_MB": 0.3}))
    outcome = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS)
    assert outcome.exit_code == 0
    assert any("keep_MB" in warning.text for warning in Result.read(outcome.folder.result).warnings or [])
    assert 0.3e6 < outcome.folder.trace.stat().st_size < 0.32e6
    assert read_recording(outcome.folder.recording).time_s[-1] > 1.9
    assert write_report(outcome.folder).exists()
