"""The process of the diagnosis beside a bench: ready before the first cycle, and never in its way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.model_changes.process import LiveProcess
from hilbench.bench.reports.diagnosis_updates import CHUNK_CYCLES, Samples
from hilbench.errors import BenchFaultError
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "live_friction.yaml"


@pytest.mark.slow
def test_in_real_time_it_is_ready_before_a_cycle_and_gets_only_what_nobody_else_wants(tmp_path: Path) -> None:
    config = load_with_overrides(CONFIG, changes=["pace=realtime", "realtime.priority=null"]).config
    process = LiveProcess(config, tmp_path)
    try:
        process.wait_until_ready()
        assert os.sched_getscheduler(process.pid) == os.SCHED_IDLE
        assert len(os.sched_getaffinity(process.pid)) == 1
        group = Path(f"/proc/{process.pid}/autogroup")
        if group.exists():
            assert group.read_text().split()[-1] == "19"
        status = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        caught = next(int(line.split()[1], 16) for line in status if line.startswith("SigCgt:"))
        assert caught >> (signal.SIGPROF - 1) & 1, "it works in slices"
        rows = np.zeros((CHUNK_CYCLES, len(config.signals)))
        assert process.ask(Samples.of(CHUNK_CYCLES - 1, rows)).result(60.0).cycle == CHUNK_CYCLES - 1
    finally:
        process.end()


@pytest.mark.slow
def test_beside_cycles_that_come_first_in_any_case_it_has_a_share_of_what_they_leave(tmp_path: Path) -> None:
    if not priority_is_permitted():
        pytest.skip("SCHED_FIFO is not permitted here")
    config = load_with_overrides(CONFIG, changes=["pace=realtime", "realtime.priority=20"]).config
    process = LiveProcess(config, tmp_path)
    try:
        process.wait_until_ready()
        assert os.sched_getscheduler(process.pid) == os.SCHED_OTHER
        rows = np.zeros((CHUNK_CYCLES, len(config.signals)))
        assert process.ask(Samples.of(CHUNK_CYCLES - 1, rows)).result(60.0).cycle == CHUNK_CYCLES - 1
        # Who hands them over has the interpreter's lock at times: right behind the twin, which is one below the bench.
        (hands_over,) = (each.native_id for each in threading.enumerate() if each.name.startswith("live-diagnosis"))
        assert hands_over is not None
        assert (os.sched_getscheduler(hands_over), os.sched_getparam(hands_over).sched_priority) == (os.SCHED_FIFO, 18)
    finally:
        process.end()


def priority_is_permitted() -> bool:
    """Asked in a process of its own: this one stays what it is."""
    asked = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))"
    return subprocess.run([sys.executable, "-c", asked], capture_output=True, check=False).returncode == 0


@pytest.mark.slow
def test_a_bench_boots_its_nodes_only_when_the_diagnosis_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    ready = LiveProcess.wait_until_ready

    def wait(self: LiveProcess) -> None:
        ready(self)
        said.append("ready")

    monkeypatch.setattr(LiveProcess, "wait_until_ready", wait)
    config = load_with_overrides(CONFIG).config
    with Bench(config, participants=Participants.IN_PROCESS, announce=said.append):
        pass
    assert said.index("ready") < said.index("boot simulated hardware and twin")


def test_a_bench_whose_diagnosis_can_not_start_says_why_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hilbench.bench.model_changes.process._MODULE", "hilbench.no_such_module")
    bench = Bench(load_with_overrides(CONFIG).config, work_folder=tmp_path, participants=Participants.IN_PROCESS)
    with pytest.raises(BenchFaultError, match=r"live diagnosis ended by itself: .*no_such_module"), bench:
        pass


@pytest.mark.slow
def test_beside_processes_of_their_own_the_same_is_seen_as_in_one(tmp_path: Path) -> None:
    def run(participants: Participants) -> RunOutcome:
        loaded = load_with_overrides(CONFIG, changes=[f"bus.address=embedded:live-{os.getpid()}"])
        data = loaded.config.model_dump()
        friction = {"path": "load.effects.coulomb_friction.axis2.force_N", "to": 5.0}
        data["steps"] = [
            {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 1.0}},
            {"hold": {"until_s": 3.0}},
            {"step": friction},
            {"hold": {"until_s": 6.0}},
            {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 1.0}},
        ]
        data["criteria"] = []
        changed = LoadedConfig(type(loaded.config).model_validate(data), loaded.document)
        return run_experiment(changed, tmp_path / participants.value, participants=participants)

    apart, here = run(Participants.STARTED), run(Participants.IN_PROCESS)
    assert apart.result.gap_history == here.result.gap_history
    assert max(gap for gap in (apart.result.gap_history or here.result.gap_history).in_use if gap) > 0.15
    recordings = [read_recording(outcome.folder.recording) for outcome in (apart, here)]
    assert all(np.array_equal(recordings[0][name], recordings[1][name]) for name in ("F_true_N", "F_sim_N", "v1_m_s"))
