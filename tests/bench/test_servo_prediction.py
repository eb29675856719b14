"""A bench of a servo axis that looks ahead: what it announces, what it does about it, and what could not be known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import Shipped
from tests.cli.in_process import hilbench

from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_PASSED
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
#: Ramps by which the twin finds the inertia, a step of it at 2.6 s, and a ramp at 3 s that takes the torque to 3.2 N·m.
STEPS = """steps=[
  {ramp: {path: speed_rad_s, to: 20.0, duration_s: 0.6}}, {ramp: {path: speed_rad_s, to: 5.0, duration_s: 0.5}},
  {ramp: {path: speed_rad_s, to: 20.0, duration_s: 0.5}}, {ramp: {path: speed_rad_s, to: 5.0, duration_s: 0.5}},
  {hold: {until_s: 2.6}}, {step: {path: load.shaft.inertia_kg_m2, to: 0.06}}, {hold: {until_s: 3.0}},
  {ramp: {path: speed_rad_s, to: 20.0, duration_s: 0.4}}, {hold: {duration_s: 0.2}},
  {ramp: {path: speed_rad_s, to: 0.0, duration_s: 0.6}}]"""
WARNS = "safety.limits.torque_Nm={warning: 2.8}"
TRIPS = "safety.limits.torque_Nm={trip: 2.8}"


def run(folder: Path, *changes: str, steps: str = STEPS) -> RunOutcome:
    prediction = "twin.prediction={horizon_s: 1.5, futures: 32}"
    loaded = load_with_overrides(CONFIGS / "servo_axis.yaml", changes=(steps, prediction, "criteria=[]", *changes))
    return run_experiment(loaded, folder, participants=Participants.IN_PROCESS)


@pytest.fixture(scope="module")
def announced(tmp_path_factory: pytest.TempPathFactory) -> RunOutcome:
    """The experiment with a warning level that its last ramp crosses."""
    return run(tmp_path_factory.mktemp("runs"), WARNS)


def test_a_torque_that_a_planned_ramp_asks_for_is_announced_before_it_comes(announced: RunOutcome) -> None:
    assert announced.exit_code == EXIT_PASSED, announced.result.faults
    (made,) = announced.result.predicted or ()
    assert (made.signal, made.quantity, made.level) == ("tau1_Nm", "torque of axis 1", "warning")
    assert made.crossed_s == pytest.approx(made.expected_s, abs=0.03)
    assert made.probability > 0.9
    assert announced.result.metrics["prediction_lead_s"] > 1.0
    assert announced.result.metrics["limits_not_predicted"] == 0.0


def test_a_friction_that_nobody_knows_of_crosses_its_limit_unannounced(tmp_path: Path) -> None:
    steps = STEPS.replace(
        "{step: {path: load.shaft.inertia_kg_m2, to: 0.06}}",
        "{step: {path: load.effects.coulomb_friction.axis1.torque_Nm, to: 4.0}}",
    )
    outcome = run(tmp_path, WARNS, steps=steps)
    assert outcome.exit_code == EXIT_PASSED, outcome.result.faults
    assert outcome.result.metrics["limits_not_predicted"] >= 1.0
    assert [each for each in outcome.result.predicted or () if each.t_s < 2.6] == []


def test_a_bench_that_is_to_stop_does_so_before_the_limit_is_crossed(tmp_path: Path) -> None:
    outcome = run(tmp_path, TRIPS, "safety.on_predicted_limit=stop")
    assert outcome.exit_code == EXIT_BENCH_FAULT
    (fault,) = outcome.result.faults
    assert "predicted: torque of axis 1 beyond its trip level 2.8 N·m" in fault.text
    assert fault.time_s is not None
    assert fault.time_s < 3.0
    (made,) = outcome.result.predicted or ()
    assert (made.action, made.crossed_s) == ("stopped", None)


def test_a_ramp_that_would_trip_the_limit_is_refused_before_it_is_done(tmp_path: Path) -> None:
    steps = STEPS.replace("to: 20.0, duration_s: 0.4}", "to: 20.0, duration_s: 0.4, check: predicted}")
    outcome = run(tmp_path, TRIPS, steps=steps)
    assert outcome.exit_code == EXIT_BENCH_FAULT
    (fault,) = outcome.result.faults
    assert "speed_rad_s to 20 is refused: torque of axis 1 beyond its trip level 2.8 N·m" in fault.text
    recording = read_recording(outcome.folder.recording)
    assert np.max(np.abs(recording["tau1_Nm"])) < 2.8


def test_what_is_asked_before_it_is_done_is_what_came_when_it_was_done(announced: RunOutcome) -> None:
    done = hilbench(
        "what-if", announced.folder.path, "--set", "speed_rad_s=20", "--over", "0.4", "--at", "3.0", "--horizon", "0.7",
        "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer, recording = json.loads(done.stdout), read_recording(announced.folder.recording)
    times_s = np.array(answer["times_s"])
    ramp = times_s < 3.58
    for signal, largest in (("tau1_Nm", 0.15), ("v1_rad_s", 0.2)):
        course, came = answer["courses"][signal], np.interp(times_s, recording.time_s, recording[signal])
        # The inertia is still the one from before its step: its torque is a fifth less than what comes.
        known = (
            came
            if signal == "v1_rad_s"
            else came
            - (0.06 - 0.048) * np.gradient(np.interp(times_s, recording.time_s, recording["v1_rad_s"]), times_s)
        )
        off = np.abs(np.array(course["median"]) - known)[ramp]
        assert np.median(off) < largest, signal
    assert answer["asked"] == [
        {"path": "speed_rad_s", "before": pytest.approx(5.0), "to": 20.0, "end_s": pytest.approx(3.4)}
    ]


def test_what_cannot_be_asked_of_a_servo_axis_is_refused_in_one_line(announced: RunOutcome) -> None:
    done = hilbench("what-if", announced.folder.path, "--set", "line_speed_m_s=5")
    assert (done.returncode, done.stdout) == (2, "")
    assert "'line_speed_m_s', expected one of speed_rad_s, load.shaft.inertia_kg_m2" in done.stderr


@pytest.mark.slow
def test_the_shipped_experiment_knows_its_crossings_before(shipped: Shipped) -> None:
    outcome = shipped("servo_predicted_limit")
    assert outcome.exit_code == EXIT_PASSED, outcome.result.criteria
    for each in outcome.result.predicted or ():
        assert each.crossed_s == pytest.approx(each.expected_s, abs=0.05)
