"""A line whose loops go by what the twin knows: neighbours are not disturbed."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from hilbench.bench.lifecycle.participants import Participants
from hilbench.compiled import interpreted, record_at
from hilbench.control.web_line.feed_forward import ROLLER, lead_m_s, roller
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, advance, strain_trajectory, velocity_before
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "line_two_spans.yaml"
STEPS = """steps=[
  {ramp: {path: line_speed_m_s, to: 2.0, duration_s: 1.0}}, {hold: {until_s: 3.0}},
  {step: {path: tension_control.span1.set_point_N, to: 90.0}}, {hold: {duration_s: 3.0}},
  {ramp: {path: line_speed_m_s, to: 1.5, duration_s: 1.0}}, {hold: {duration_s: 1.0}}]"""
CYCLE_S = 0.003
SECTION_M2 = 3e-5
lead = interpreted(lead_m_s)


def trajectory_at(tension_N: float) -> Any:
    of_web = 4.0, SECTION_M2, tension_N / (9e9 * SECTION_M2)
    return record_at(strain_trajectory(0.4, CYCLE_S, *of_web), TRAJECTORY)


@cache
def steps_of_span_1(feed_forward: str) -> dict[str, np.ndarray]:
    folder = Path(mkdtemp())
    changes = [f"controllers.{name}.feed_forward={feed_forward}" for name in ("infeed_tension", "press_tension")]
    given = load_with_overrides(CONFIG, changes=[*changes, STEPS, "criteria=[]"], bus=f"embedded:{folder.name}")
    outcome = run_experiment(given, folder / "runs", participants=Participants.IN_PROCESS)
    assert outcome.result.faults == []
    found = read_recording(outcome.folder.recording)
    return {name: np.asarray(found[name]) for name in ("t_s", "F1_true_N", "F2_true_N", "F1_ref_N", "F2_ref_N")}


def largest_error_N(found: dict[str, np.ndarray], span: int, start_s: float, end_s: float) -> float:
    part = (found["t_s"] > start_s) & (found["t_s"] < end_s)
    return float(np.max(np.abs(found[f"F{span}_true_N"] - found[f"F{span}_ref_N"])[part]))


@pytest.mark.slow
def test_a_step_of_a_span_does_not_disturb_the_span_behind_it_which_it_does_without_feed_forward() -> None:
    assert largest_error_N(steps_of_span_1("twin"), 2, 3.0, 6.0) < 1.0
    assert largest_error_N(steps_of_span_1("none"), 2, 3.0, 6.0) > 2.0


def test_the_stepped_span_itself_is_there_within_its_rise_time() -> None:
    assert largest_error_N(steps_of_span_1("twin"), 1, 3.0 + 0.4 + 0.05, 6.0) < 1.0


def test_a_ramp_of_the_line_speed_leaves_the_tensions() -> None:
    found = steps_of_span_1("twin")
    for span in (1, 2):
        assert largest_error_N(found, span, 6.0, 7.9) < 1.0


def test_a_set_point_goes_its_way_smoothly_and_arrives() -> None:
    way = trajectory_at(80.0)
    found = []
    for _ in range(200):
        advance(way, 90.0, 9e9)
        found.append(way.tension_N)
    after = round(0.4 / CYCLE_S)
    assert found[after] == pytest.approx(90.0, abs=0.25)
    assert found[-1] == pytest.approx(90.0, abs=0.02)
    assert np.all(np.diff(found) > 0)
    assert np.max(np.abs(np.diff(found, 2))) < 0.05
    assert way.length_m * way.rate_per_s == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("behind_m_s", [3.0, 0.0, -3.0])
def test_a_roller_before_a_span_lets_in_what_the_way_of_the_strain_needs_in_both_directions(behind_m_s: float) -> None:
    """By what comes into the span and goes out of it, unstretched, at the strains of where it comes from."""
    way, length_m, others = trajectory_at(80.0), 4.0, 3e-4
    material_m = length_m / (1.0 + 80.0 / (9e9 * 3e-5))
    for _ in range(400):
        before_m_s = velocity_before(way, behind_m_s, others)
        strain = length_m / material_m - 1.0
        into, out_of = (others, strain) if behind_m_s >= 0.0 else (strain, others)
        material_m += CYCLE_S * (before_m_s / (1.0 + into) - behind_m_s / (1.0 + out_of))
        advance(way, 90.0, 9e9)
    assert (length_m / material_m - 1.0) * 9e9 * 3e-5 == pytest.approx(90.0, abs=0.1)


def test_a_change_of_E_leaves_the_strain_and_only_then_goes_back_to_the_set_point() -> None:
    way = trajectory_at(90.0)
    advance(way, 90.0, 10.8e9)
    assert way.tension_N == pytest.approx(90.0 * 1.2, rel=1e-3)
    for _ in range(300):
        advance(way, 90.0, 10.8e9)
    assert way.tension_N == pytest.approx(90.0, abs=1e-3)


def test_a_roller_that_is_told_its_force_keeps_its_speed() -> None:
    """By the drive's equations, in steps a hundredth of a cycle long."""
    mass_kg, kp, ki, force_N = 30.0, 900.0, 18000.0, 40.0
    forces = record_at(roller(mass_kg, kp, ki, 1e9, CYCLE_S), ROLLER)
    lead(forces, 0.0, 0.0)
    speed_m_s = integral_N = 0.0
    travel_m, way_alone_m, alone_m_s, alone_N = 0.0, 0.0, 0.0, 0.0
    for _ in range(200):
        ahead_m_s = lead(forces, 0.0, force_N)
        for _ in range(100):
            step_s = CYCLE_S / 100
            integral_N += ki * (ahead_m_s - speed_m_s) * step_s
            speed_m_s += (kp * (ahead_m_s - speed_m_s) + integral_N - force_N) / mass_kg * step_s
            travel_m += speed_m_s * step_s
            alone_N -= ki * alone_m_s * step_s
            alone_m_s += (-kp * alone_m_s + alone_N - force_N) / mass_kg * step_s
            way_alone_m += alone_m_s * step_s
    assert way_alone_m == pytest.approx(-force_N / ki, rel=0.01)
    assert abs(travel_m) < 0.03 * abs(way_alone_m)
