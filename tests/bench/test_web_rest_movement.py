"""The bench asks a line at rest, beside which a twin is started: a small movement tells E and the web's strain."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.bench.whole_runs import SHIPPED, config, run_folders, run_here
from tests.cli.in_process import hilbench
from tests.tiers import slow
from tests.twin.beside_stations import dancer_line, guided_line, winding_line

from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.tasks.web_standstill_excitation import Positions, StandstillExcitation, excitation_amplitudes_m
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.journal import read_journal
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides
from hilbench.topology.sample import sample_type
from hilbench.topology.web_line_config import rest_misfit
from hilbench.topology.web_line_quantities import TENSION_PROBE

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
    tmp_path: Path, probing: object, steps: list[object], friction_N: float = 0.0, seed: int = 1
) -> tuple[Recording, list[float], str]:
    """The recording, what the journal has of probes, and what was said."""
    path = config(
        tmp_path,
        steps=steps,
        seed=seed,
        controllers={"tension_control": {"set_point_N": 80.0, "probing": probing}},
        twin={"youngs_modulus_Pa": 0.6 * 8.7e9},
        hardware={"effects": [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": friction_N}}]},
    )
    code, said, errors = run_here(path)
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
    assert "probe: the rollers move by up to 1 mm for up to 20 s" in said
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


#: With 20 N the roller takes up what pulls at it for some tenths of a second before it breaks loose.
@pytest.mark.parametrize(
    ("friction_N", "seed"),
    [
        (20.0, 2),
        *slow((5.0, 1), (12.0, 1), (20.0, 1), (20.0, 3), (20.0, 4), (20.0, 5), (20.0, 6), (30.0, 1), (30.0, 2)),
    ],
)
def test_it_tells_E_from_friction_that_the_model_does_not_know(friction_N: float, seed: int, tmp_path: Path) -> None:
    later_s = 16.0
    steps = [*FOUND[:-1], {"hold": {"until_s": later_s}}, *RUN]
    recording, _, said = ran(tmp_path, {"mode": "on", "at_rest_mm": 1.0}, steps, friction_N, seed)
    assert "not told" not in said
    error, deviation = relative_error(recording), np.asarray(recording["E_sd_Pa"]) / 8.7e9
    # The roller stands under that friction, and E is held.
    assert np.abs(error[rows(recording, later_s - 1.0, later_s)]).max() < 0.015
    runs = rows(recording, later_s + 2.0, later_s + 4.0)
    assert np.abs(error[runs]).max() < 0.015  # 6 and 17 % without the movement
    assert np.mean(np.abs(error[runs]) <= 1.96 * deviation[runs]) > 0.95


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


def movement_of(
    axes: int, travel_m: float, pulled_m: np.ndarray, positions_m: Positions
) -> tuple[StandstillExcitation, SimpleNamespace, list[SimpleNamespace]]:
    leader, moved = SimpleNamespace(creep_m_s=0.0), [SimpleNamespace(pull_m_s=0.0) for _ in range(axes)]
    return StandstillExcitation(leader, moved, positions_m, travel_m, pulled_m, CYCLE_S), leader, moved


def line_model(name: str, **changes: object) -> ModelParameters:
    model = load_with_overrides(SHIPPED.with_name(name)).config.web_line
    return ModelParameters.model_validate(model.model_dump() | changes)


SHIPPED_LINES = ["web_section_step.yaml", "line_two_spans.yaml", "line_three_spans.yaml"]


@pytest.mark.parametrize("travel_m", [0.2e-3, 1e-3])
@pytest.mark.parametrize("tension_N", [0.0, 20.0, 500.0])
@pytest.mark.parametrize("name", SHIPPED_LINES)
def test_rollers_that_nothing_holds_go_no_farther_than_is_permitted(
    name: str, tension_N: float, travel_m: float
) -> None:
    model = line_model(name)
    pulled_m = excitation_amplitudes_m(model, [tension_N] * model.span_count, travel_m)
    movement, leader, axes = movement_of(model.axis_count, travel_m, pulled_m, lambda _: [0.0] * model.axis_count)
    travels_m = np.zeros((round(15.0 / CYCLE_S), len(axes)))
    for way in travels_m:
        movement.go_on()
        way[:] = [(leader.creep_m_s + axis.pull_m_s) * CYCLE_S for axis in axes]
    assert np.abs(np.cumsum(travels_m, axis=0)).max() <= travel_m
    movement.end()
    assert leader.creep_m_s == 0.0
    assert all(isnan(axis.pull_m_s) for axis in axes)


def test_a_roller_that_is_turned_by_something_else_is_noticed() -> None:
    at_m = [0.0, 2.0, 5.0]
    movement, _, _ = movement_of(3, WAY_M, np.array([-1e-4, 0.0, 1e-4]), lambda _: tuple(at_m))
    sample = sample_type([])()
    movement.begin(sample)
    at_m[2] += 0.9e-3
    assert not movement.is_beyond(sample)
    at_m[2] += 0.2e-3
    assert movement.is_beyond(sample)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_the_tension_of_every_span_goes_up_and_down_alike(share: float) -> None:
    set_points_N = share * np.array([80.0, 85.0, 90.0])
    model = line_model("line_three_spans.yaml")
    told_m = excitation_amplitudes_m(model, set_points_N.tolist(), 1e-3)
    # Springs in a row, of the webs and of what holds the rollers; the first is held as it is told.
    web = np.array([model.stiffness_N(span) / model.span_length_m(span) for span in (1, 2, 3)])
    held = model.drive_stiffness_N_per_m(2)
    stiffness = np.diag(held + web + np.append(web[1:], 0.0)) - np.diag(web[1:], 1) - np.diag(web[1:], -1)
    moved_m = np.linalg.solve(stiffness, held * told_m[1:] + np.array([web[0] * told_m[0], 0.0, 0.0]))
    tensions_N = web * np.diff(np.insert(moved_m, 0, told_m[0]))
    assert tensions_N / set_points_N == pytest.approx(0.15 if share < 1.0 else 0.132, rel=0.01)


LINES = [SHIPPED.with_name(f"line_{number}_spans.yaml") for number in ("two", "three")]


#: Webs that are strained otherwise than that upstream, and a twin that finds them.
LINE_FOUND: list[object] = [
    {"hold": {"duration_s": 1.0}},
    {"set": {"path": "tension_control.span1.set_point_N", "to": 55.0}},
    {"set": {"path": "tension_control.span2.set_point_N", "to": 100.0}},
    {"hold": {"until_s": RESTARTED_S}},
    {"restart_twin": {}},
]
RUN_LINE: list[object] = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 3.0}},
    {"hold": {"duration_s": 3.5}},
]
LATER_S = 26.0


def line_of_spans(folder: Path, shipped: Path, probing: str, steps: list[object]) -> tuple[Recording, list[float]]:
    """A run of a line whose twin believes E to be 0.6 of what it is, and what the journal has of probes."""
    changes = [
        f"controllers.infeed_tension.probing={probing}",
        "twin.youngs_modulus_Pa=5.22e9",
        *(f"steps={steps}", "criteria=[]"),
    ]
    given = load_with_overrides(shipped, bus=f"embedded:{folder.name}", changes=changes)
    outcome = run_experiment(given, folder / "runs", participants=Participants.IN_PROCESS)
    assert outcome.result.faults == []
    journal = [each.value for each in read_journal(outcome.folder.path / "journal.log") if each.path == TENSION_PROBE]
    return read_recording(outcome.folder.recording), journal


def error_of(recording: Recording, span: int) -> np.ndarray:
    return np.asarray(recording[f"E{span}_sim_Pa"]) / np.asarray(recording[f"E{span}_true_Pa"]) - 1.0


@pytest.mark.slow
@pytest.mark.parametrize("shipped", LINES)
def test_it_tells_E_and_strain_of_every_span_of_a_line(shipped: Path, tmp_path: Path) -> None:
    steps = [*LINE_FOUND, {"hold": {"until_s": LATER_S}}, *RUN_LINE]
    recording, journal = line_of_spans(tmp_path, shipped, "{mode: on, at_rest_mm: 1.0}", steps)
    assert journal == [1.0, 0.0]
    rests = rows(recording, RESTARTED_S + 0.1, LATER_S)
    status = np.asarray(recording["twin_status"]).astype(int)
    known_s = recording.time_s[rests[np.flatnonzero(status[rests] & 2)[0]]]
    later = rows(recording, known_s + 0.5, LATER_S + 6.5)
    spans = sum(name.endswith("_sim_N") for name in recording.channels)
    for axis in range(1, spans + 2):
        positions = np.asarray(recording[f"x{axis}_m"])[rests]
        assert 1e-4 < np.abs(positions - positions[0]).max() <= WAY_M
    for span in range(1, spans + 1):
        error, deviation = error_of(recording, span), np.asarray(recording[f"E{span}_sd_Pa"]) / 8.7e9
        assert np.mean(np.abs(error[rests]) <= 1.96 * deviation[rests]) > 0.95
        assert np.abs(error[later]).max() < 0.01
        apart_N = np.asarray(recording[f"F{span}_sim_N"])[later] - np.asarray(recording[f"F{span}_true_N"])[later]
        assert np.abs(apart_N).max() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("shipped", LINES)
def test_without_leave_the_web_that_leaves_tells_E_of_every_span(shipped: Path, tmp_path: Path) -> None:
    steps = [*LINE_FOUND, {"hold": {"until_s": RESTARTED_S + 1.0}}, *RUN_LINE]
    recording, journal = line_of_spans(tmp_path, shipped, "off", steps)
    assert journal == []
    begins_s = RESTARTED_S + 1.0
    rests, runs = rows(recording, RESTARTED_S + 0.3, begins_s), rows(recording, RESTARTED_S + 0.3, begins_s + 6.5)
    spans = sum(name.endswith("_sim_N") for name in recording.channels)
    for span in range(1, spans + 1):
        error, deviation = error_of(recording, span), np.asarray(recording[f"E{span}_sd_Pa"]) / 8.7e9
        assert np.all(deviation[rests] > 0.5)
        assert np.mean(np.abs(error[runs]) <= 1.96 * deviation[runs]) > 0.95
        assert np.abs(error[rows(recording, begins_s + 3.0 + 2.0, begins_s + 6.5)]).max() < 0.01


@pytest.mark.parametrize("key", ["twin.web_at_rest=unknown", "controllers.infeed_tension.probing={at_rest_mm: 1.0}"])
def test_webs_that_nothing_tells_are_refused_in_one_line(key: str) -> None:
    done = hilbench("check", LINES[0], "--set", key, "--set", "twin.estimate=[{method: changepoint, span: 1}]")
    assert done.returncode == 2
    assert "not without span 2" in done.stdout + done.stderr


def test_on_a_line_with_stations_nothing_is_asked_at_rest_and_told_where_carriages_and_reels_have_sensors() -> None:
    stations = SHIPPED.with_name("line_with_dancer.yaml")
    done = hilbench("check", stations, "--set", "controllers.outfeed_tension.probing={at_rest_mm: 1.0}")
    assert done.returncode == 2
    assert "on a line with 'stations:'" in done.stdout + done.stderr
    unknown = EstimationConfig(web_at_rest="unknown")
    expected = "'load: {measured: [dancer]}' with 'web_at_rest: unknown', not without dancer"
    assert rest_misfit(unknown, dancer_line(), [], []) == expected
    assert rest_misfit(unknown, dancer_line(), [], ["dancer"]) is None
    both = "'load: {measured: [unwinder, rewinder]}' with 'web_at_rest: unknown', not without rewinder"
    assert rest_misfit(unknown, winding_line(), [], ["unwinder"]) == both
    assert rest_misfit(unknown, guided_line(), [], []) is None
