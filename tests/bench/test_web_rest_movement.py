"""The bench asks a line at rest, beside which a twin is started: a small movement tells E and the web's strain."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.bench.whole_runs import SHIPPED, config, run_folders, run_here
from tests.cli.in_process import hilbench

from hilbench.bench.tasks.web_rest_movement import RestMovement
from hilbench.results.journal import read_journal
from hilbench.results.recording import Recording, read_recording
from hilbench.topology.quantities import TENSION_PROBE
from hilbench.topology.sample import sample_type

CYCLE_S, WAY_M = 0.002, 1e-3
RESTARTED_S, RUNS_S = 3.0, 13.0
#: A web that is strained otherwise than that upstream, and a twin that finds it.
FOUND = [
    {"hold": {"duration_s": 1.0}},
    {"set": {"path": "tension_control.set_point_N", "to": 55.0}},
    {"hold": {"until_s": RESTARTED_S}},
    {"restart_twin": {}},
    {"hold": {"until_s": RUNS_S}},
]
RUN = [
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 2.0}},
    {"hold": {"duration_s": 2.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 1.0}},
]


def ran(
    tmp_path: Path, probing: object, steps: list[object], friction_N: float = 0.0
) -> tuple[Recording, list[float], str]:
    """The recording, what the journal has of probes, and what was said."""
    path = config(
        tmp_path,
        steps=steps,
        controllers={"tension_control": {"set_point_N": 80.0, "probing": probing}},
        twin={"youngs_modulus_Pa": 0.6 * 8.7e9},
        hardware={"effects": [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": friction_N}}]},
    )
    code, said, errors = run_here(path, "--no-report")
    assert code == 0, errors
    folder = run_folders(path)[0]
    journal = [each.value for each in read_journal(folder / "journal.log") if each.path == TENSION_PROBE]
    return read_recording(folder / "recording.mf4"), journal, said + errors


def rows(recording: Recording, begin_s: float, end_s: float) -> np.ndarray:
    return np.asarray(np.flatnonzero((recording.time_s >= begin_s) & (recording.time_s < end_s)))


def relative_error(recording: Recording) -> np.ndarray:
    return np.asarray(recording["E_sim_Pa"]) / np.asarray(recording["E_true_Pa"]) - 1.0


def test_it_tells_E_and_strain_of_a_web_that_a_twin_finds_at_rest(tmp_path: Path) -> None:
    recording, journal, said = ran(tmp_path, {"mode": "on", "at_rest_mm": 1.0}, [*FOUND, *RUN])
    assert journal == [1.0, 0.0]
    assert "probe: the rollers move by up to 1 mm for up to 15 s" in said
    moved = rows(recording, RESTARTED_S + 0.1, RUNS_S)
    known = moved[np.asarray(recording["E_sd_Pa"])[moved] < 0.1 * 8.7e9]
    unknown = moved[moved < known[0]]
    error, deviation = relative_error(recording), np.asarray(recording["E_sd_Pa"]) / np.asarray(recording["E_true_Pa"])
    assert np.all(np.abs(error[unknown]) <= 1.96 * deviation[unknown])
    for axis in (1, 2):
        positions = np.asarray(recording[f"x{axis}_m"])[unknown]
        assert 1e-4 < np.abs(positions - positions[0]).max() <= WAY_M
    # Both are known from then on, at rest and as the line begins to run: the tension that the loop goes by is true.
    later = rows(recording, recording.time_s[known[0]] + 0.5, RUNS_S + 4.0)
    assert np.abs(error[later]).max() < 0.01
    apart_N = np.asarray(recording["F_sim_N"])[later] - np.asarray(recording["F_true_N"])[later]
    assert np.abs(apart_N).max() < 1.0


def test_it_tells_E_from_friction_that_the_model_does_not_know(tmp_path: Path) -> None:
    recording, _, said = ran(tmp_path, {"mode": "on", "at_rest_mm": 1.0}, [*FOUND, *RUN], friction_N=5.0)
    assert "not told" not in said
    runs = rows(recording, RUNS_S + 2.0, RUNS_S + 4.0)
    error, deviation = relative_error(recording)[runs], np.asarray(recording["E_sd_Pa"])[runs] / 8.7e9
    assert np.abs(error).max() < 0.015  # 6 % without the movement
    assert np.mean(np.abs(error) <= 1.96 * deviation) > 0.95


def test_without_leave_nothing_moves_and_the_twin_says_that_it_knows_nothing(tmp_path: Path) -> None:
    recording, _, said = ran(tmp_path, "on", [*FOUND, *RUN])
    rests = rows(recording, RESTARTED_S + 1.0, RUNS_S)
    for axis in (1, 2):
        assert np.ptp(np.asarray(recording[f"x{axis}_m"])[rests]) < 1e-5
    assert np.all(np.asarray(recording["E_sd_Pa"])[rests] > 0.5 * np.asarray(recording["E_sim_Pa"])[rests])
    assert not np.any(np.asarray(recording["twin_status"]).astype(int)[rests] & 2)
    assert "the rollers move" not in said
    runs = rows(recording, RUNS_S + 2.0 + 1.5, RUNS_S + 4.0)
    assert np.abs(relative_error(recording)[runs]).max() < 0.01


def test_an_operator_is_asked_first_and_may_end_it(tmp_path: Path) -> None:
    allowed: list[object] = [
        {"set": {"path": TENSION_PROBE, "to": 1}},
        {"hold": {"duration_s": 1.0}},
        {"set": {"path": TENSION_PROBE, "to": 0}},
        {"hold": {"duration_s": 1.0}},
    ]
    steps = [*FOUND[:-1], {"hold": {"until_s": 7.0}}, *allowed]
    recording, journal, said = ran(tmp_path, {"mode": "ask", "at_rest_mm": 1.0}, steps)
    positions = np.asarray(recording["x2_m"])
    assert np.ptp(positions[rows(recording, 4.0, 7.0)]) < 1e-5
    assert np.ptp(positions[rows(recording, 7.0, 8.0)]) > 1e-4
    assert np.ptp(positions[rows(recording, 8.2, 9.0)]) < 1e-5
    assert "probe: wanted" in said
    assert journal == [1.0, 1.0, 0.0, 0.0]  # allowed, begun, to be ended, ended


@pytest.mark.parametrize("way_m", [0.2e-3, 1e-3])
@pytest.mark.parametrize("pulled_m", [0.0, 0.1e-3, 1.0])
def test_rollers_that_nothing_holds_go_no_farther_than_is_permitted(way_m: float, pulled_m: float) -> None:
    axis = SimpleNamespace(creep_m_s=0.0, pull_m_s=0.0)
    movement = RestMovement(axis, lambda _: (0.0, 0.0), way_m, pulled_m, CYCLE_S)
    ways_m = np.zeros((round(15.0 / CYCLE_S), 2))
    for way in ways_m:
        movement.go_on()
        way[:] = np.array([axis.creep_m_s, axis.creep_m_s + axis.pull_m_s]) * CYCLE_S
    assert np.abs(np.cumsum(ways_m, axis=0)).max() <= way_m
    movement.end()
    assert axis.creep_m_s == axis.pull_m_s == 0.0


def test_a_roller_that_is_turned_by_something_else_is_noticed() -> None:
    axis = SimpleNamespace(creep_m_s=0.0, pull_m_s=0.0)
    at_m = [0.0, 5.0]
    movement = RestMovement(axis, lambda _: (at_m[0], at_m[1]), WAY_M, 1e-4, CYCLE_S)
    sample = sample_type([])()
    movement.begin(sample)
    at_m[1] += 0.9e-3
    assert not movement.is_beyond(sample)
    at_m[1] += 0.2e-3
    assert movement.is_beyond(sample)


def test_a_line_of_several_spans_is_refused() -> None:
    several = SHIPPED.with_name("line_two_spans.yaml")
    done = hilbench("check", several, "--set", "controllers.infeed_tension.probing={mode: on, at_rest_mm: 1.0}")
    assert done.returncode == 2
    assert "at_rest_mm" in done.stdout + done.stderr
