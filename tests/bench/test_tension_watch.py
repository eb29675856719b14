"""The tension loop opens on a twin whose estimator is broken, by torques and encoders, and on no other."""

from __future__ import annotations

from math import nan
from pathlib import Path

import numpy as np
import pytest
from tests.bench.broken_twin import Fault, broken
from tests.bench.whole_runs import Shipped, config
from tests.tiers import slow

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
CYCLE_S, BREAKS_S, SET_POINT_N = 0.002, 22.0, 80.0
STEP_PA, E_PA = 10.5e9, 8.7e9
RAMP = {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 2.0}}


def held(until_s: float) -> list[dict[str, object]]:
    return [RAMP, {"hold": {"until_s": until_s}}]


def run(folder: Path, path: Path | None = None, **changes: object) -> RunOutcome:
    loaded = load_with_overrides(path or config(folder, **changes))
    return run_experiment(loaded, folder / "runs", participants=Participants.IN_PROCESS)


def openings(outcome: RunOutcome) -> list[tuple[float | None, str]]:
    found = [warning for warning in outcome.result.warnings or [] if warning.source == "twin"]
    return [(warning.time_s, warning.text) for warning in found]


def frozen(since_s: float, modulus_Pa: float) -> float:
    return E_PA / modulus_Pa


FAULTS = [
    (lambda since_s, modulus_Pa: 1.0 + 0.02 * since_s, 5.0),
    *slow((lambda since_s, modulus_Pa: 1.3, 2.0), (lambda since_s, modulus_Pa: 0.75, 2.0)),
]


@pytest.mark.parametrize(("fault", "within_s"), FAULTS)
def test_a_broken_estimator_opens_the_loop_which_goes_back_to_the_set_point(
    tmp_path: Path, fault: Fault, within_s: float
) -> None:
    with broken(fault, first_cycle=round(BREAKS_S / CYCLE_S)):
        outcome = run(tmp_path, steps=held(42.0))
    ((opened_s, text),) = openings(outcome)
    assert opened_s is not None
    # The twin's first cycle is some hundredths of a second before the experiment's.
    assert BREAKS_S < opened_s < BREAKS_S + within_s
    assert "tension loop open, axis 1 follows the ratio of speeds: tension by the twin is" in text
    assert "N, the torques allow" in text
    assert outcome.result.metrics["twin_refusals"] == 1.0
    recording = read_recording(outcome.folder.recording)
    true_N = recording["F_true_N"]
    assert np.abs(true_N[-500:] - SET_POINT_N).max() < 2.0
    assert recording["loop_closed"][-1] == 0


def test_an_estimator_that_is_frozen_when_E_steps_opens_the_loop(tmp_path: Path) -> None:
    steps = [
        *held(BREAKS_S),
        {"step": {"path": "load.web.youngs_modulus_Pa", "to": STEP_PA}},
        {"hold": {"until_s": 39.0}},
    ]
    with broken(frozen, first_cycle=round(20.0 / CYCLE_S)):
        outcome = run(tmp_path, steps=steps)
    ((opened_s, _),) = openings(outcome)
    assert opened_s is not None
    assert BREAKS_S < opened_s < BREAKS_S + 2.0
    true_N = read_recording(outcome.folder.recording)["F_true_N"]
    assert abs(true_N[-1] - SET_POINT_N) < 0.4 * (SET_POINT_N * STEP_PA / E_PA - SET_POINT_N)  # within L·(1 + κ)/v, 5 s


@pytest.mark.slow
def test_an_estimator_without_numbers_ends_the_run_at_once(tmp_path: Path) -> None:
    with broken(lambda since_s, modulus_Pa: nan, first_cycle=round(4.0 / CYCLE_S)):
        outcome = run(tmp_path, steps=held(10.0))
    assert outcome.exit_code == 3
    assert "estimate of E over the model's is inf, beyond its trip level" in outcome.result.faults[0].text


def test_the_loop_closes_without_a_jump_when_the_estimator_is_back(tmp_path: Path) -> None:
    with broken(lambda since_s, modulus_Pa: 1.3, first_cycle=round(BREAKS_S / CYCLE_S), cycles=1500):
        outcome = run(tmp_path, steps=held(40.0))
    (opened_s, _), (closed_s, text) = openings(outcome)
    assert opened_s is not None
    assert closed_s is not None
    assert text == "tension loop closed again: the twin is synchronized"
    assert 5.0 < closed_s - opened_s < 10.0
    recording = read_recording(outcome.folder.recording)
    at = int(np.searchsorted(recording.time_s, closed_s))
    commands_m_s = recording["v1_cmd_m_s"]
    largest = np.abs(np.diff(commands_m_s[at - 500 : at - 5])).max()
    assert np.abs(np.diff(commands_m_s[at - 5 : at + 50])).max() < 2.0 * largest
    assert abs(recording["F_true_N"][-1] - SET_POINT_N) < 1.0


@pytest.mark.slow
def test_every_span_has_its_own_opinion_and_a_reset_twin_is_a_new_one(tmp_path: Path) -> None:
    only_second = iter(range(1 << 30))  # spans are asked for in their order
    with broken(lambda since_s, modulus_Pa: 1.4 if next(only_second) % 2 else 1.0, first_cycle=3500, cycles=2000):
        path = tmp_path / "two.yaml"
        path.write_text(
            f"include: {ROOT / 'bench_configs' / 'line_two_spans.yaml'}\nsteps:\n"
            "  - ramp: {path: line_speed_m_s, to: 2.0, duration_s: 2.0}\n  - hold: {until_s: 12.0}\n"
            "  - {restart_twin: {}}\n  - hold: {duration_s: 6.0}\ncriteria: []\n"
        )
        outcome = run(tmp_path, path)
    texts = [text for _, text in openings(outcome)]
    assert "tension loop of span 2 open" in texts[0]
    assert "tension of span 2 by the twin is" in texts[0]
    assert not any("span 1 by the twin" in text for text in texts)


RUNS = ["web_section_step", "hidden_friction", "hidden_eccentricity", "line_three_spans", "line_with_dancer"]
SLOW_RUNS = [
    *("hidden_disturbance", "hidden_inertia", "hidden_offset", "hidden_ripple", "hidden_slip"),
    *("hidden_softening", "hidden_span", "hidden_dancer", "line_two_spans", "web_section_step_pid", "probing"),
    *("predicted_limit", "giannoccaro_2016", "scenario", "live_friction", "live_line_friction", "kuhm_2012"),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*RUNS, *SLOW_RUNS])
def test_no_loop_is_opened_on_a_twin_that_is_right(shipped: Shipped, name: str) -> None:
    outcome = shipped(name)
    assert outcome.result.metrics["twin_refusals"] == 0.0
    assert not [text for _, text in openings(outcome) if "by the twin is" in text]


#: Two deviations of what a model may lack (`ModelErrorsConfig`), and a tension upstream that swings.
USUAL = [
    ("hardware", {"effect": "torque_offset", "axis": 2, "parameters": {"offset_Nm": 0.108}}),
    ("hardware", {"effect": "torque_scale", "axis": 2, "parameters": {"relative_change": -0.14}}),
    ("hardware", {"effect": "inertia_mismatch", "axis": 2, "parameters": {"relative_change": 0.2}}),
    ("hardware", {"effect": "viscous_friction", "axis": 2, "parameters": {"coefficient_N_s_per_m": 5.3}}),
    ("hardware", {"effect": "unbalance", "axis": 2, "parameters": {"amplitude_Nm": 1.28, "phase_rad": 0.5}}),
    ("load", {"effect": "roller_eccentricity", "axis": 1, "parameters": {"amplitude_m": 4e-5, "phase_rad": 0.5}}),
    ("load", {"effect": "upstream_disturbance", "parameters": {"amplitude_N": 4.0, "frequency_Hz": 0.3}}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("where", "effect"), USUAL, ids=[effect["effect"] for _, effect in USUAL])
def test_no_loop_is_opened_by_what_a_model_usually_lacks(tmp_path: Path, where: str, effect: dict[str, object]) -> None:
    """Steps of E by +21 and −40 %, a stop, another start and another set-point."""
    to = "load.web.youngs_modulus_Pa"
    steps = [
        *held(9.0),
        {"step": {"path": to, "to": STEP_PA}},
        {"hold": {"duration_s": 8.0}},
        {"step": {"path": to, "to": 0.6 * E_PA}},
        {"hold": {"duration_s": 8.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 2.0}},
        {"hold": {"duration_s": 8.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 1.0}},
        {"hold": {"duration_s": 8.0}},
        {"set": {"path": "tension_control.set_point_N", "to": 95.0}},
        {"hold": {"duration_s": 8.0}},
    ]
    outcome = run(tmp_path, steps=steps, **{where: {"effects": [effect]}})
    assert outcome.result.metrics["twin_refusals"] == 0.0
