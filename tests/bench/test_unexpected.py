"""An exception that nobody foresaw, anywhere in a run: the drives stop, the result says why, the exit code is 3."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.bench.whole_runs import config, run_folders
from tests.cli.in_process import hilbench
from tests.tiers import slow

from hilbench.bench.cycle import CompiledCycles
from hilbench.bench.lifecycle import in_process
from hilbench.bench.operator.operator import Operator
from hilbench.bench.operator.operator_objects import OperatorObjects
from hilbench.bench.tasks.limits import LimitWatch
from hilbench.bench.tasks.load_model import LoadModel
from hilbench.bench.tasks.tension_task import TensionTask
from hilbench.bench.tasks.twin_connection import TwinConnection
from hilbench.cia402.state_machine import State
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.measured import Measured
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.hardware.simulation import RigApplication
from hilbench.in_process_cycle.cycles import FastPathCycles
from hilbench.results import run as runs
from hilbench.results.journal import JournalWriter
from hilbench.results.recording_builder import RecordingBuilder
from hilbench.results.result import Result
from hilbench.results.trace import TraceWriter
from hilbench.topology.sample import CycleSample
from hilbench.twin.machines.web_line import WebLineTwin
from hilbench.twin.process import TwinApplication

MOVING = [{"ramp": {"path": "line_speed_m_s", "to": 0.5, "duration_s": 0.2}}, {"hold": {"duration_s": 1.0}}]
#: So many calls of the experiment's 0.2 s ramp are past that all of them happen while the line moves.
CALLS = 250
#: 0.5 m/s are 12.5 rad/s of the motors.
AT_REST_RAD_S = 1.0
#: What fast-path cycles (`hilbench.in_process_cycle`) do without.
OF_INTERPRETED_CYCLES = {
    (Nodes, "decode"),
    (Nodes, "encode"),
    (MasterNode, "handle"),
    (TraceWriter, "write"),
    (SyncCycle, "exchange"),
    (WebLineTwin, "compare"),
}


#: What is called for 32 cycles at once.
OF_CHAINS = {"write_lines", "count", "pass_fast_path"}


def one_by_one(patch: pytest.MonkeyPatch) -> None:
    """Every cycle is Python's, as where a task is."""
    patch.setattr(CompiledCycles, "run", lambda self, cycles: 0)


class Stands:
    """The simulated hardware of a run, to look at when it is over."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.application: RigApplication | None = None
        made = in_process.hardware

        def kept(bench: Any) -> Any:
            hosted = made(bench)
            self.application = hosted.application
            return hosted

        patch.setattr(in_process, "hardware", kept)

    @property
    def states(self) -> set[State]:
        assert self.application is not None
        return {drive.state for drive in self.application.drives}

    @property
    def fastest_rad_s(self) -> float:
        assert self.application is not None
        outputs = self.application.rig.outputs()
        return max(abs(outputs["v1_rad_s"]), abs(outputs["v2_rad_s"]))


def breaks(patch: pytest.MonkeyPatch, owner: type, name: str, error: Exception, *, after: int, for_good: bool) -> None:
    """Let a function raise at its n-th call, once or from then on."""
    original, calls = getattr(owner, name), [0]

    def broken(*arguments: Any, **keywords: Any) -> Any:
        calls[0] += 1
        if calls[0] == after or (for_good and calls[0] > after):
            raise error
        return original(*arguments, **keywords)

    patch.setattr(owner, name, broken)


def ended(path: Path, folder: Path) -> tuple[Result, str, str]:
    ran = hilbench("run", path, "--in-process", "--no-report", "--out", folder)
    assert ran.returncode == 3, (ran.stdout, ran.stderr)
    assert "Traceback" not in ran.stdout + ran.stderr
    (run,) = run_folders(path)
    kept = run / "traceback.txt"
    return Result.read(run / "result.json"), kept.read_text() if kept.exists() else "", ran.stdout


@pytest.mark.parametrize("for_good", [True, *slow(False)])
@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (TensionTask, "before"),
        (LoadModel, "follow_in"),
        (FastPathCycles, "cycle"),
        (SyncCycle, "exchange"),
        (RecordingBuilder, "sample"),
        *slow(
            (LimitWatch, "update"),
            (Nodes, "decode"),
            (Nodes, "encode"),
            (Measured, "fill"),
            (TwinConnection, "before"),
            (Nodes, "pass_fast_path"),
            (MasterNode, "handle"),
            (OperatorObjects, "changes"),
            (TraceWriter, "write"),
            (TraceWriter, "write_lines"),
            (Exchange, "cycle"),
            (SyncCycle, "count"),
            (WebLineTwin, "compare"),
            (TwinApplication, "count_syncs"),
            (Operator, "set"),
        ),
    ],
)
def test_whatever_breaks_in_mid_run_the_drives_stop_and_the_result_says_what(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: type, name: str, for_good: bool
) -> None:
    stand = Stands(monkeypatch)
    if (owner, name) in OF_INTERPRETED_CYCLES:
        monkeypatch.setattr(FastPathCycles, "cycle", lambda self, outputs: False)
    if name not in OF_CHAINS:
        one_by_one(monkeypatch)
    after = {"set": 50, "write": 4 * CALLS}.get(name, CALLS // 32 if name in OF_CHAINS else CALLS)
    breaks(monkeypatch, owner, name, KeyError("nobody foresaw"), after=after, for_good=for_good)
    result, kept, said = ended(config(tmp_path, steps=MOVING), tmp_path / "runs")
    assert result.faults[0].source == "bench"
    assert result.faults[0].text.startswith("unexpected KeyError in ")
    assert "nobody foresaw" in result.faults[0].text
    assert "traceback.txt" in result.faults[0].text
    assert "KeyError: 'nobody foresaw'" in kept
    assert "unexpected KeyError" in said
    assert State.OPERATION_ENABLED not in stand.states
    if not for_good:
        assert stand.fastest_rad_s < AT_REST_RAD_S
        assert result.timing.cycles >= 49  # a step may come at 0.1 s


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        *slow(RecursionError("too deep"), OSError(24, "Too many open files"), ZeroDivisionError("x"), EOFError()),
    ],
    ids=lambda error: type(error).__name__,
)
def test_whatever_kind_of_exception_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    one_by_one(monkeypatch)
    stand = Stands(monkeypatch)
    breaks(monkeypatch, LimitWatch, "update", error, after=CALLS, for_good=False)
    result, _, _ = ended(config(tmp_path, steps=MOVING), tmp_path / "runs")
    assert result.faults[0].text.startswith(f"unexpected {type(error).__name__} in ")
    assert result.faults[0].time_s is not None
    assert stand.states == {State.SWITCH_ON_DISABLED}
    assert stand.fastest_rad_s < AT_REST_RAD_S


@pytest.mark.parametrize(
    ("owner", "name", "after"),
    [
        (Nodes, "configure_drives", 1),
        (Nodes, "configure_twin", 1),
        (JournalWriter, "write", 1),
        (LoadModel, "warm_up", 1),
    ],
)
def test_what_breaks_before_anything_moves_has_a_result_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: type, name: str, after: int
) -> None:
    breaks(monkeypatch, owner, name, TypeError("early"), after=after, for_good=False)
    result, _, _ = ended(config(tmp_path, steps=MOVING), tmp_path / "runs")
    assert result.faults[0].text.startswith("unexpected TypeError in ")


def test_what_breaks_after_the_run_leaves_recording_and_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: Any, **options: Any) -> None:
        raise IndexError("in the metrics")

    monkeypatch.setattr(runs, "judge", broken)
    path = config(tmp_path, steps=MOVING, criteria=[{"name": "steady", "metric": "E_noise_pct", "max": 10.0}])
    result, kept, _ = ended(path, tmp_path / "runs")
    assert result.faults[0].source == "metrics"
    assert not result.passed
    assert "IndexError: in the metrics" in kept
    assert (run_folders(path)[0] / "recording.mf4").exists()


def test_a_run_folder_that_somebody_removed_is_told_and_what_is_known_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one_by_one(monkeypatch)
    original, calls = LimitWatch.update, [0]

    def removing(self: LimitWatch, sample: Any) -> list[str]:
        calls[0] += 1
        if calls[0] == CALLS:
            (folder,) = (tmp_path / "runs").iterdir()
            for file in folder.iterdir():
                file.unlink()
            folder.rmdir()
        return original(self, sample)

    monkeypatch.setattr(LimitWatch, "update", removing)
    result, _, _ = ended(config(tmp_path, steps=MOVING), tmp_path / "runs")
    assert "was removed while the run wrote to it" in result.faults[0].text
    assert result.timing.cycles == 600
    (folder,) = (tmp_path / "runs").iterdir()
    assert (folder / "recording.mf4").exists()


def test_a_result_that_can_not_be_written_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one_by_one(monkeypatch)
    original, calls = LimitWatch.update, [0]

    def replacing(self: LimitWatch, sample: Any) -> list[str]:
        calls[0] += 1
        if calls[0] == CALLS:
            (folder,) = (tmp_path / "runs").iterdir()
            folder.rename(tmp_path / "elsewhere")
            folder.write_text("a file in its place")
        return original(self, sample)

    monkeypatch.setattr(LimitWatch, "update", replacing)
    ran = hilbench("run", config(tmp_path, steps=MOVING), "--in-process", "--no-report", "--out", tmp_path / "runs")
    assert ran.returncode == 3
    assert ran.stderr.count("\n") == 1
    assert "drives were stopped; then" in ran.stderr
    assert "cannot be written (Not a directory)" in ran.stderr


def test_the_result_of_what_nobody_foresaw_is_plain_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one_by_one(monkeypatch)
    breaks(monkeypatch, LimitWatch, "update", ValueError("a\nb \udcff ü"), after=CALLS, for_good=False)
    result, _, _ = ended(config(tmp_path, steps=MOVING), tmp_path / "runs")
    assert "a\\nb \\udcff ü" in result.faults[0].text
    json.loads((run_folders(tmp_path / "bench.yaml")[0] / "result.json").read_text())


@pytest.mark.parametrize("signal", ["E_sim_Pa", "x2_m", *slow("F_sim_N", "tau2_Nm")])
@pytest.mark.parametrize("value", [float("nan"), *slow(0.0, 1e-45, float("inf"))])
def test_whatever_number_a_node_says_the_run_goes_on_or_ends_by_a_fault_that_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signal: str, value: float
) -> None:
    one_by_one(monkeypatch)
    original, calls = Measured.fill, [0]

    def forged(self: Measured, sample: CycleSample) -> None:
        original(self, sample)
        calls[0] += 1
        if calls[0] >= CALLS:
            setattr(sample, signal, value)

    monkeypatch.setattr(Measured, "fill", forged)
    path = config(tmp_path, steps=[MOVING[0], {"hold": {"duration_s": 0.4}}])
    ran = hilbench("run", path, "--in-process", "--no-report", "--out", tmp_path / "runs", "--json")
    result = Result.read(Path(json.loads(ran.stdout)["files"]["result"]))
    assert ran.returncode == (3 if result.faults else 0), ran
    assert "unexpected" not in ran.stdout + ran.stderr
    if signal == "E_sim_Pa":
        assert "estimate of E over the model's" in result.faults[0].text
