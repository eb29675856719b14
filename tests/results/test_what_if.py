"""What would come: futures from a run's recording, and from the trace of one that has none yet."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.cli.in_process import hilbench

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results import what_if as what_if_module
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
STEPS = """steps=[
  {ramp: {path: line_speed_m_s, to: 2.0, duration_s: 1.0}}, {hold: {until_s: 3.0}},
  {step: {path: tension_control.set_point_N, to: 100.0}}, {hold: {duration_s: 2.0}}]"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 m/s from 1 s on; the set-point goes from 80 to 100 N at 3 s."""
    loaded = load_with_overrides(CONFIG, changes=[STEPS, "criteria=[]"])
    folder = tmp_path_factory.mktemp("runs")
    return run_experiment(loaded, folder, participants=Participants.IN_PROCESS).folder.path


def answered(run: Path, *options: str) -> dict[str, object]:
    done = hilbench("what-if", run, *options, "--json")
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def test_what_is_asked_before_it_is_done_is_what_came_when_it_was_done(run: Path) -> None:
    answer = answered(run, "--set", "tension_control.set_point_N=100", "--at", "2.998", "--horizon", "2")
    recording = read_recording(run / "recording.mf4")
    course = answer["courses"]["F_true_N"]  # type: ignore[index]
    came = np.interp(answer["times_s"], recording.time_s, recording["F_true_N"])  # type: ignore[arg-type]
    inside = came < 1e9
    inside[-1] = False  # beyond the run
    off = np.abs(np.array(course["median"]) - came)[inside]
    assert np.max(off) < 2.0  # of the 20 N of the step, while it is under way
    assert np.max(off[10:]) < 0.5
    band = (np.array(course["low"]) - 2.0 <= came) & (came <= np.array(course["high"]) + 2.0)
    assert np.mean(band[inside]) > 0.9
    assert answer["asked"] == [
        {"path": "tension_control.set_point_N", "before": 80.0, "to": 100.0, "end_s": pytest.approx(2.998)}
    ]


def test_a_speed_beyond_its_limit_is_seen_with_its_time(run: Path) -> None:
    answer = answered(run, "--set", "line_speed_m_s=9", "--at", "2.9", "--horizon", "4")
    crossings = {each["signal"]: each for each in answer["crossings"]}  # type: ignore[attr-defined]
    assert crossings["v2_m_s"]["level"] == "warning"
    # From 2 to 8 m/s at the 3 m/s² at which the bench moves the speed.
    assert crossings["v2_m_s"]["expected_s"] - 2.9 == pytest.approx(2.0, abs=0.1)
    slower = answered(run, "--set", "line_speed_m_s=9", "--at", "2.9", "--horizon", "4", "--over", "14")
    assert not [each for each in slower["crossings"] if each["probability"] > 0.01]  # type: ignore[attr-defined]


def test_a_run_that_still_goes_on_is_read_from_its_trace(run: Path, tmp_path: Path) -> None:
    going_on = tmp_path / "run"
    shutil.copytree(run, going_on)
    (going_on / "recording.mf4").unlink()
    question = ("--set", "line_speed_m_s=3", "--at", "4.5", "--horizon", "2")
    one, same = answered(run, *question), answered(going_on, *question)
    for signal in ("F_true_N", "tau2_Nm", "v2_m_s"):
        assert one["courses"][signal]["median"] == pytest.approx(  # type: ignore[index]
            same["courses"][signal]["median"],  # type: ignore[index]
            abs=0.05,
        )


@pytest.mark.slow
def test_a_bench_that_runs_is_asked_on_its_bus(tmp_path: Path) -> None:
    address = f"embedded:what-if-{os.getpid()}"
    config = load_with_overrides(CONFIG, bus=address).config
    with Bench(config, work_folder=tmp_path) as bench:
        bench.ramp("line_speed_m_s", 2.0, 1.0)
        bench.set("tension_control.set_point_N", 90.0)
        bench.run(1.0)
        asked = ("--set", "tension_control.set_point_N=100", "--horizon", "2", "--json")
        command = [sys.executable, "-m", "hilbench", "what-if", str(CONFIG), "--bus", address, *asked]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            while process.poll() is None:
                bench.cycle()
            answer = json.loads(process.stdout.read() if process.stdout else "")
        bench.set("tension_control.set_point_N", 100.0)
        bench.run(1.9)
        came_N = bench.last.F_true_N
        bench.ramp("line_speed_m_s", 0.0, 1.0)
    (move,) = answer["asked"]
    assert (move["before"], move["to"]) == (90.0, 100.0)
    tensions_N = answer["courses"]["F_true_N"]["median"]
    assert 90.0 < tensions_N[0] < 98.0
    assert tensions_N[-1] == pytest.approx(came_N, abs=1.0)
    assert answer["courses"]["v2_m_s"]["median"][-1] == pytest.approx(2.0, abs=0.05)


def test_a_bus_without_a_bench_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(what_if_module, "_LONGEST_S", 0.25)
    done = hilbench("what-if", CONFIG, "--bus", f"embedded:nobody-{os.getpid()}", "--set", "line_speed_m_s=3")
    assert done.returncode == 2
    assert "no SYNC within 0.25 s, expected a bench that runs" in done.stderr


def test_a_terminal_of_80_columns_shows_every_figure_whole(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    done = hilbench("what-if", run, "--set", "line_speed_m_s=1", "--horizon", "1")
    head = done.stdout.partition("\n\n")[0]
    assert "probability" in head
    assert "300 / 400" in head
    assert head.count("…") == head.count(" … ")


def test_the_terminal_shows_numbers_and_courses_and_the_page_is_written(run: Path, tmp_path: Path) -> None:
    page = tmp_path / "what_if.html"
    done = hilbench("what-if", run, "--set", "line_speed_m_s=9", "--horizon", "3", "--out", page)
    assert done.returncode == 0, done.stderr
    assert "line_speed_m_s 2 → 9 within 2.33 s" in done.stdout
    assert "tension of the web, N" in done.stdout
    assert "speed of axis 2 beyond its warning level 8 m/s in 2.0 s, probability 100 %" in done.stdout
    assert "━" in done.stdout
    assert "░" in done.stdout
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") >= 6
    assert "line_speed_m_s 2 → 9 within 2.33 s" in text


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--set", "line_speed_m_s"), "expected PATH=NUMBER"),
        (("--set", "load.web.broken=1"), "expected one of line_speed_m_s, tension_control.set_point_N"),
        (("--set", "tension_control.set_point_N=-5"), "expected a number from 0"),
        (("--set", "line_speed_m_s=1", "--at", "99"), "expected a time of the run"),
        (("--set", "line_speed_m_s=1", "--at", "0.01"), "the twin is not synchronized"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(run: Path, options: tuple[str, ...], expected: str) -> None:
    done = hilbench("what-if", run, *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert expected in done.stderr
    assert done.stderr.count("\n") == 1
