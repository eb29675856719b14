"""`hilbench diagnose CONFIG`: runs of the bench, what is made of them, and what is not when they are cut short."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import yaml
from tests.bench.whole_runs import config, gone
from tests.cli.in_process import hilbench

from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis import web_line_bench_gap as bench_gap
from hilbench.results.run import run_experiment
from hilbench.runs.config import load

#: Friction that the model does not know: the twin's E comes out 5 % too high until the model has it.
FRICTION = {"effects": [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": 4.2}}]}
STEPS: list[dict[str, object]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 0.6}},
    {"hold": {"duration_s": 1.0}},
    {"set": {"path": "tension_control.set_point_N", "to": 95.0}},
    {"hold": {"duration_s": 1.2}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.5, "duration_s": 0.6}},
    {"hold": {"duration_s": 1.0}},
    {"set": {"path": "tension_control.set_point_N", "to": 80.0}},
    {"hold": {"duration_s": 1.0}},
]
AS_LONG_AS_E_IS_RIGHT = """
def experiment(bench):
    for _ in range(200):
        if (yield).E_sim_Pa > 9e9:
            return
"""


@pytest.fixture
def in_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_gap, "run_experiment", partial(run_experiment, participants=Participants.IN_PROCESS))


def start(path: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "hilbench", "diagnose", path.name, "--out", "."]
    return subprocess.Popen(
        words, cwd=path.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def read_until(process: subprocess.Popen[str], text: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if text in line:
            return
    raise AssertionError(f"it never said: {text}")


def the_run(path: Path) -> Path:
    (folder,) = (path.parent / "runs").iterdir()
    return folder


@pytest.mark.slow
def test_ctrl_c_while_the_bench_runs_stops_the_drives_and_diagnoses_nothing(tmp_path):
    path = config(tmp_path, steps=[{"hold": {"duration_s": 1000.0}}])
    process = start(path)
    read_until(process, "t = 5.0 s")
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1].startswith("hilbench: runs/")
    assert "interrupted, drives were stopped" in err
    assert out == ""
    controlwords = [
        line.split("#")[1][:4] for line in (the_run(path) / "trace.log").read_text().splitlines() if " 201#" in line
    ]
    assert controlwords[-1] == "0200"  # quick stop was the last that axis 1 was told
    assert not (path.parent / "diagnosis.html").exists()
    assert gone(path)


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["start simulated hardware", "simulate the model"])
def test_ctrl_c_before_or_after_the_run_ends_it_as_well(tmp_path, phase):
    path = config(tmp_path, steps=STEPS, hardware=FRICTION)
    process = start(path)
    read_until(process, phase)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert not (path.parent / "diagnosis.html").exists()
    assert gone(path)


def test_a_run_that_faults_is_exit_3_with_the_reason_and_no_verdict(tmp_path, in_one_process):
    limits = {"limits": {"speed_m_s": {"warning": 0.5, "trip": 1.5}}}
    path = config(tmp_path, steps=STEPS, safety=limits)
    done = hilbench("diagnose", path, "--out", tmp_path)
    assert done.returncode == 3
    assert done.stdout == ""
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"hilbench: {tmp_path / 'runs'}/")
    assert "1.5 m/s" in last
    assert not (tmp_path / "diagnosis.html").exists()


@pytest.mark.slow
def test_the_extended_bench_that_faults_is_shown_as_not_compared_and_is_exit_3(tmp_path, in_one_process):
    wait = {"wait_until": {"condition": "E_sim_Pa > 9e9", "timeout_s": 0.5}}
    path = config(tmp_path, steps=[*STEPS, wait], hardware=FRICTION)
    done = hilbench("diagnose", path, "--out", tmp_path / "found", "--json")
    assert done.returncode == 3, done.stderr
    assert "did not come true within 0.5 s" in done.stderr
    data = json.loads(done.stdout)
    assert data["verdict"] == "named"
    assert len(data["live"]) == 1
    assert "did not come true" in data["not_compared"]
    assert "Not compared" in (tmp_path / "found" / "diagnosis.html").read_text()


@pytest.mark.slow
def test_runs_of_different_length_are_not_compared(tmp_path, in_one_process):
    (tmp_path / "steps.py").write_text(AS_LONG_AS_E_IS_RIGHT)
    path = config(tmp_path, steps=[*STEPS, {"python": {"file": "steps.py"}}], hardware=FRICTION)
    done = hilbench("diagnose", path, "--out", tmp_path / "found")
    assert done.returncode == 0, done.stderr
    assert "not compared: the run with the extended model took " in done.stdout
    assert "extended model ┃" not in done.stdout
    assert "Not compared" in (tmp_path / "found" / "diagnosis.html").read_text()


@pytest.fixture
def found(tmp_path: Path, in_one_process: None) -> Path:
    """What a diagnosis on a bench writes: of a config that lies elsewhere."""
    path = config(tmp_path, steps=STEPS, hardware=FRICTION)
    done = hilbench("diagnose", path, "--out", tmp_path / "a" / "found")
    assert done.returncode == 0, done.stderr
    return tmp_path / "a" / "found"


@pytest.mark.slow
def test_the_extended_config_and_an_include_of_the_extended_model_are_benches_with_what_was_found(found, tmp_path):
    page = (found / "diagnosis.html").read_text()
    assert f"hilbench run {found / 'config_extended.yaml'}" in page
    assert "include: [my_bench.yaml, model_extended.yaml]" in page
    mine = found / "mine.yaml"
    mine.write_text("include: [../../bench.yaml, model_extended.yaml]\nname: mine\n")
    effects = yaml.safe_load((found / "model_extended.yaml").read_text())["effects"]
    original = load(tmp_path / "bench.yaml")[0]
    for path, name in ((found / "config_extended.yaml", f"{original.name}_extended"), (mine, "mine")):
        extended = load(path)[0]
        assert extended.name == name
        assert [entry.model_dump(exclude_none=True) for entry in extended.machine.effects] == effects
        assert extended.model_copy(update={"name": original.name, "machine": original.machine}) == original
    assert effects
    assert hilbench("check", found / "config_extended.yaml").returncode == 0
    # A recording diagnosed with the extended bench as its model has nothing left to find.
    (first, _) = sorted((found / "runs").iterdir())
    again = hilbench("diagnose", first / "recording.mf4", "--model", found / "config_extended.yaml", "--json")
    assert json.loads(again.stdout)["verdict"] == "complete"


@pytest.mark.slow
def test_off_a_terminal_each_new_thing_is_a_line_on_standard_error(tmp_path, in_one_process):
    path = config(tmp_path, steps=[*STEPS, {"hold": {"duration_s": 1.0}}])
    done = hilbench("diagnose", path, "--out", tmp_path / "found")
    said = [line.split(maxsplit=2)[2] for line in done.stderr.splitlines()]
    assert {"run the bench: t = 0.0 s", "run the bench: t = 5.0 s", "simulate the model"} <= set(said)
    assert said.index("run the bench: t = 5.0 s") < said.index("simulate the model")


def test_until_clear_of_a_recording_is_refused(tmp_path):
    recording = tmp_path / "run.csv"
    recording.write_text("t_s,x1_m\n0,0\n1,1\n")
    done = hilbench("diagnose", recording, "--until-clear")
    assert done.returncode == 2
    assert "a recording, expected with --until-clear a bench config" in done.stderr


def test_set_and_bus_are_those_of_the_run_that_is_diagnosed(tmp_path, in_one_process):
    path = config(tmp_path, steps=STEPS)
    changes = ["--set", "safety.limits.speed_m_s={warning: 0.5, trip: 1.25}", "--bus", "embedded:of_the_option"]
    done = hilbench("diagnose", path, "--out", tmp_path, *changes)
    assert done.returncode == 3
    assert "1.25 m/s" in done.stderr.splitlines()[-1]
    assert load(the_run(path) / "config.yaml")[0].bus.address == "embedded:of_the_option"
    recording = tmp_path / "run.csv"
    recording.write_text("t_s,x1_m\n0,0\n1,1\n")
    refused = hilbench("diagnose", recording, "--model", path, "--set", "seed=3")
    assert refused.returncode == 2
    assert "--set seed=3: with a recording, expected a bench config that is run" in refused.stderr
