"""Samples that come late: counted by participant, told, known as old to the load model, named as a cause."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from tests.bench.late_senders import late
from tests.bench.whole_runs import config

from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.machines.servo_axis import shaft_load_model
from hilbench.bench.tasks.emulated_web import web_load_model
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load, load_with_overrides

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
SERVO = SHIPPED.with_name("servo_axis.yaml")
STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 0.8}},
    {"hold": {"duration_s": 1.2}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.8}},
]
AXIS2, TWIN = {0x182, 0x282}, {0x1A0, 0x2A0, 0x3A0}
CYCLE_S = 0.002


def run(folder: Path, **changes: object) -> RunOutcome:
    loaded = load_with_overrides(config(folder, **({"steps": STEPS} | changes)))
    return run_experiment(loaded, folder / "runs", participants=Participants.IN_PROCESS)


@pytest.mark.slow
def test_late_samples_are_counted_by_participant_and_told(tmp_path: Path) -> None:
    with late(0.18, AXIS2, from_cycle=150):
        outcome = run(tmp_path)
    assert outcome.exit_code == 0
    timing = outcome.result.timing
    assert timing.late is not None
    assert timing.late.keys() == {"axis2 (node 2)"}
    found = timing.late["axis2 (node 2)"]
    assert found.share_pct == pytest.approx(18.0, abs=3.0)
    assert timing.metrics()["late_samples_pct"] == found.share_pct
    assert timing.warnings()[0].startswith("axis2 (node 2): 1")
    write_report(outcome.folder)
    assert "late samples of axis2 (node 2)" in outcome.folder.report.read_text(encoding="utf-8")
    # Not one of them is taken for the position of this cycle, at any speed.
    tension = np.asarray(read_recording(outcome.folder.recording)["F_true_N"])
    assert tension.min() > 65.0
    assert tension.max() < 90.0


def test_a_load_model_without_positions_of_one_instant_warns_and_then_ends_the_run(tmp_path: Path) -> None:
    steps = [*STEPS[:1], {"hold": {"duration_s": 8.0}}]
    with late(1.0, AXIS2, from_cycle=500):
        outcome = run(tmp_path, steps=steps)
    assert outcome.exit_code == 3
    assert any("load torques are held for 1.0 s" in warning.text for warning in outcome.result.warnings or [])
    (fault,) = outcome.result.faults
    assert fault.time_s == pytest.approx(6.0, abs=0.1)
    assert "load model: load torques are held for 5.0 s" in fault.text


def test_a_twin_that_is_a_cycle_late_is_counted_and_the_loop_stays_closed(tmp_path: Path) -> None:
    with late(0.5, TWIN, from_cycle=150):
        outcome = run(tmp_path)
    assert outcome.exit_code == 0
    assert outcome.result.timing.late is not None
    found = outcome.result.timing.late["virtual io (node 32)"]
    assert found.share_pct == pytest.approx(50.0, abs=4.0)
    recording = read_recording(outcome.folder.recording)
    assert np.all(np.asarray(recording["loop_closed"])[500:-200])
    assert np.max(np.abs(np.asarray(recording["F_true_N"])[800:1000] - 80.0)) < 3.0


def test_in_lockstep_nobody_is_late(tmp_path: Path) -> None:
    outcome = run(tmp_path)
    assert outcome.result.timing.late == {}
    assert outcome.result.timing.metrics()["late_samples_pct"] == 0.0


def test_a_fault_names_the_late_samples_before_it(tmp_path: Path) -> None:
    limits = {"limits": {"speed_m_s": {"warning": None, "trip": 1.5}}}
    with late(0.3, AXIS2, from_cycle=150):
        outcome = run(tmp_path, safety=limits)
    assert outcome.exit_code == 3
    fault = outcome.result.faults[0].text
    assert "beyond its trip level 1.5 m/s; before that, from t = 0." in fault
    assert "% late samples of axis2 (node 2)" in fault


def swinging(cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions of two rollers at 2 m/s whose web swings at 10 Hz, by 8 % of its strain."""
    t = np.arange(cycles) * CYCLE_S
    x2_m = 2.0 * t
    return x2_m + 2e-5 * np.sin(2 * np.pi * 10.0 * t), x2_m


def torques(ages: list[int], *, told: bool = True) -> np.ndarray:
    """The load motor's torque when the positions of a cycle are so many cycles old."""
    bench = load(SHIPPED)[0]
    model = web_load_model(bench)
    x1_m, x2_m = swinging(len(ages))
    found = []
    for k, age in enumerate(ages):
        late_now = told and k > 0 and age > ages[k - 1]
        positions = float(x1_m[k - age]), float(x2_m[k - age])
        found += model.update(positions, (2.0, 2.0), late=late_now)
    return np.array(found)


def test_the_web_follows_late_samples_over_the_time_that_has_gone_by() -> None:
    draw = random.Random(2)
    ages = [0] * 50
    while len(ages) < 1000:
        ages += [1, 0] if draw.random() < 0.18 else [0]
    in_time = torques([0] * len(ages))[100:]
    swing = np.ptp(in_time)
    assert np.max(np.abs(torques(ages)[100:] - in_time)) < 0.35 * swing
    fresh = np.array(ages[100:]) == 0
    assert np.max(np.abs(torques(ages)[100:] - in_time)[fresh]) < 0.15 * swing


def test_samples_that_stay_a_cycle_old_are_predicted_over_that_cycle_too() -> None:
    ages = [0] * 100 + [1] * 400
    in_time = torques([0] * len(ages))[110:]
    swing = np.ptp(in_time)
    # As if they were of now they would lag behind by 2π·10 Hz·2 ms of the amplitude.
    assert np.max(np.abs(np.diff(in_time))) > 0.05 * swing
    # A sample that says the same again is known by the way, too.
    for told in (True, False):
        assert np.max(np.abs(torques(ages, told=told)[110:] - in_time)) < 0.025 * swing


def shaft_torques(elapsed_s: list[float], late: set[int]) -> tuple[np.ndarray, np.ndarray]:
    """Torques of the load motor of a shaft that swings between 5 and 35 rad/s, and those that they should be.

    `elapsed_s`: time of the shaft between two samples; `late`: samples that are known to be of an earlier cycle.
    """
    model = shaft_load_model(load(SERVO)[0])
    told, times_s = [], np.concatenate([[0.0], np.cumsum(elapsed_s)])
    for k, t in enumerate(times_s):
        position = 20.0 * t - 15.0 / np.pi * np.sin(np.pi * t)
        told += model.update((position,), (20.0 - 15.0 * np.cos(np.pi * t),), late=k in late)
    lead_s, emulated_less_real = 0.004, 0.048 - 0.0395
    acceleration = 15.0 * np.pi * np.sin(np.pi * (times_s + lead_s))
    speed = 20.0 - 15.0 * np.cos(np.pi * (times_s + lead_s))
    return np.array(told), -emulated_less_real * acceleration - 0.15 - 0.004 * speed


def odd_samples(kind: str, cycles: int) -> tuple[list[float], set[int]]:
    """Time of the shaft between samples, in s, and which of these are known to be late."""
    draw = random.Random(4)
    gone: list[float] = []
    late_at: set[int] = set()
    while len(gone) < cycles:
        if len(gone) < 200 or draw.random() > 0.2:
            gone.append(1.0)
        elif kind == "late, and said so":
            late_at.add(len(gone) + 1)
            gone += [0.0, 2.0]
        elif kind == "cycles that the bench has missed":
            gone.append(float(draw.randint(2, 4)))
        elif kind == "SYNC sent late, and the next in time":
            gone += [float(draw.randint(2, 4)), 0.0]
        elif kind == "one is lost, then two at once":
            gone += [0.0, 2.0]
        elif kind == "none for a while":
            gone += [0.0] * 6 + [7.0]
        else:
            jitter = draw.uniform(-0.4, 0.4)
            gone += [1.0 + jitter, 1.0 - jitter]
    return [CYCLE_S * part for part in gone], late_at


@pytest.mark.parametrize(
    "kind",
    [
        "late, and said so",
        "cycles that the bench has missed",
        "SYNC sent late, and the next in time",
        "one is lost, then two at once",
        "none for a while",
        "SYNC jitters",
    ],
)
def test_a_shaft_is_emulated_over_the_time_that_has_gone_by_between_its_samples(kind: str) -> None:
    torque, expected = shaft_torques(*odd_samples(kind, 2000))
    assert np.ptp(expected) > 0.5
    # What is held for a while, or predicted over a gap, is off by what the torque changes meanwhile.
    assert np.max(np.abs(torque - expected)[200:]) < 0.05


def test_a_shaft_that_is_stopped_by_force_is_followed_and_not_taken_for_late() -> None:
    model = shaft_load_model(load(SERVO)[0])
    position = 0.0
    for cycle in range(400):
        speed = 20.0 if cycle < 200 else 0.0
        position += speed * CYCLE_S
        (torque,) = model.update((position,), (speed,))
    assert model.machine.outputs()["v1_rad_s"] == pytest.approx(0.0, abs=1e-3)
    assert abs(torque) < 0.2
