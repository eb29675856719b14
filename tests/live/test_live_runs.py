"""Diagnosis beside a running bench, with the configs that are shipped: what comes is named, in the model, and goes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.late_senders import late
from tests.bench.missed_cycles import missed
from tests.bench.whole_runs import Shipped

from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import EXIT_PASSED, UnusableInputError
from hilbench.live.machine import SHORT
from hilbench.results.journal import read_journal
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.check import check_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.topology.blocks import LiveDiagnosisConfig
from hilbench.twin.virtual_io import TwinStatus

#: What 5 N are at the motor of axis 2, and the noise of one sample of its torque; a mean has so many.
FRICTION_Nm, TORQUE_NOISE_Nm = 5.0 * 0.2 / 5.0, 0.05
CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"


@pytest.fixture(scope="module")
def friction(shipped: Shipped) -> RunOutcome:
    return shipped("live_friction")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["live_eccentricity", "live_slip"])
def test_what_comes_while_the_line_produces_is_in_the_model_within_a_minute(name: str, shipped: Shipped) -> None:
    (came,) = shipped(name).result.found or []
    assert came.named_after_s is not None
    # By the first search: the next has data of twice the time.
    assert came.named_after_s < 2.0 * LiveDiagnosisConfig().window_s


#: Shares of the cycles that a bench on a loaded machine was too late for, and of the samples that came late.
MISSED, LATE = 0.005, 0.018


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "effect"),
    [
        ("live_friction", "coulomb_friction.axis2"),
        ("live_eccentricity", "roller_eccentricity.axis1"),
        ("live_slip", "web_slip"),
    ],
)
def test_what_comes_is_in_the_model_within_a_minute_beside_a_bench_that_misses_cycles(
    name: str, effect: str, tmp_path: Path
) -> None:
    loaded = load_with_overrides(CONFIGS / f"{name}.yaml")
    data = loaded.config.model_dump()
    sizes = [each for each in data["criteria"] if each["target"] is not None]
    bounds = {f"found.{effect}.applied_after_s": 60.0, f"found.{effect}.tension_step_N": 0.5}
    data["criteria"] = [*sizes, *({"name": metric, "metric": metric, "max": most} for metric, most in bounds.items())]
    data["steps"] = [*_until(data["steps"], 36.0), {"hold": {"until_s": 40.0}}]
    changed = LoadedConfig(type(loaded.config).model_validate(data), loaded.document)
    with missed(MISSED, from_cycle=500) as left_out, late(LATE, {0x181, 0x281}, from_cycle=500):
        outcome = run_experiment(changed, tmp_path, participants=Participants.IN_PROCESS)
    assert len(left_out) > 0.5 * MISSED * 20_000
    assert outcome.exit_code == EXIT_PASSED, [each for each in outcome.result.criteria if not each.passed]
    came = (outcome.result.found or [])[0]
    assert came.gap is not None
    assert came.gap.before > 10.0 * came.gap.noise_floor
    assert came.gap.after < 1.25 * came.gap.noise_floor


def _until(steps: list[dict[str, Any]], end_s: float) -> list[dict[str, Any]]:
    """Those that begin before a time."""
    found, now_s = [], 0.0
    for step in steps:
        if now_s >= end_s:
            break
        found.append(step)
        of = step["hold"] or step["ramp"] or {}
        now_s = of["until_s"] if of.get("until_s") is not None else now_s + (of.get("duration_s") or 0.0)
    return found


@pytest.mark.slow
def test_the_report_shows_the_gap_before_at_and_after(friction: RunOutcome) -> None:
    page = write_report(friction.folder).read_text(encoding="utf-8")
    assert "Gap between measurement and model" in page
    assert "coulomb friction, axis 2" in page
    history = friction.result.gap_history
    assert history is not None

    def largest(gaps: list[float | None], from_s: float, to_s: float) -> float:
        inside = [gap for t_s, gap in zip(history.t_s, gaps, strict=True) if from_s < t_s < to_s and gap is not None]
        return max(inside)

    came = (friction.result.found or [])[0]
    with_it_s = came.t_s + (came.applied_after_s or 0.0) + 1.0
    assert largest(history.in_use, came.t_s + 1.0, with_it_s - 3.0) > 0.15
    assert largest(history.in_use, with_it_s, 49.0) < 0.05
    assert largest(history.configured, with_it_s, 49.0) > 0.15


@pytest.mark.slow
def test_a_proposal_waits_for_the_operator_who_refuses_it(tmp_path: Path) -> None:
    loaded = load_with_overrides(CONFIGS / "live_friction.yaml", changes=["twin.live_diagnosis.model_changes=propose"])
    data = loaded.config.model_dump()
    until = next(at for at, step in enumerate(data["steps"]) if (step["hold"] or {}).get("until_s") == 50.0)
    refused = [
        {"hold": {"until_s": 36.0}},
        {"set": {"path": "twin.model_change", "to": 0.0}},
        {"hold": {"until_s": 42.0}},
    ]
    data["steps"], data["criteria"] = [*data["steps"][:until], *refused], []
    changed = LoadedConfig(type(loaded.config).model_validate(data), loaded.document)
    outcome = run_experiment(changed, tmp_path, participants=Participants.IN_PROCESS)
    (found,) = outcome.result.found or []
    assert (found.effect, found.refused, found.applied_after_s) == ("coulomb_friction", True, None)
    told = [change.what for change in read_journal(outcome.folder.journal) if change.what.startswith("model_")]
    assert told == ["model_proposed", "model_refused"]


@pytest.mark.slow
def test_a_change_that_is_announced_is_no_anomaly(tmp_path: Path) -> None:
    loaded = load_with_overrides(CONFIGS / "live_friction.yaml")
    data = loaded.config.model_dump()
    path = "load.effects.viscous_friction.axis2.coefficient_N_s_per_m"
    data["steps"] = [
        {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 3.0}},
        {"hold": {"until_s": 8.0}},
        {"step": {"path": path, "to": 2.0, "announced": True}},
        {"hold": {"until_s": 24.0}},
    ]
    data["criteria"] = [{"name": "nothing is found", "metric": "found.count", "max": 0.0}]
    changed = LoadedConfig(type(loaded.config).model_validate(data), loaded.document)
    outcome = run_experiment(changed, tmp_path, participants=Participants.IN_PROCESS)
    assert outcome.exit_code == EXIT_PASSED
    told = [change.what for change in read_journal(outcome.folder.journal) if change.what.startswith("model_")]
    assert told == ["model_announced"]
    history = outcome.result.gap_history
    assert history is not None
    assert max(gap for t_s, gap in zip(history.t_s, history.in_use, strict=True) if gap and t_s > 10.0) < 0.05
    assert max(gap for gap in history.configured if gap) > 0.2


@pytest.mark.slow
def test_a_twin_that_is_reset_gets_the_changed_model_once_more(tmp_path: Path) -> None:
    loaded = load_with_overrides(CONFIGS / "live_friction.yaml")
    data = loaded.config.model_dump()
    path = "load.effects.viscous_friction.axis2.coefficient_N_s_per_m"
    data["steps"] = [
        {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}},
        {"hold": {"until_s": 2.0}},
        {"step": {"path": path, "to": 2.0, "announced": True}},
        {"hold": {"until_s": 8.0}},
        {"restart_twin": {}},
        {"hold": {"duration_s": 7.0}},
    ]
    data["criteria"] = []
    changed = LoadedConfig(type(loaded.config).model_validate(data), loaded.document)
    recording = read_recording(run_experiment(changed, tmp_path, participants=Participants.IN_PROCESS).folder.recording)
    has_it = (np.asarray(recording["twin_status"]).astype(int) & TwinStatus.MODEL_CHANGED) > 0
    before, at, end = np.searchsorted(recording.time_s, [7.9, 8.2, recording.time_s[-1]])
    assert (has_it[before], has_it[at], has_it[end]) == (True, False, True)
    off_N = np.asarray(recording["F_true_N"]) - np.asarray(recording["F_sim_N"])
    assert abs(off_N[recording.time_s > recording.time_s[-1] - 2.0].mean()) < 0.3


@pytest.mark.slow
def test_the_result_says_what_was_found_and_when(friction: RunOutcome) -> None:
    came, went = friction.result.found or []
    assert (came.effect, came.axis, came.span, came.gone) == ("coulomb_friction", 2, None, False)
    low, high = came.parameters["force_N"].ci95
    assert low < came.parameters["force_N"].value < high
    assert came.gap is not None
    assert came.gap.before == pytest.approx(FRICTION_Nm, rel=0.03)
    assert came.gap.after < 1.1 * came.gap.noise_floor
    assert came.gap.noise_floor == pytest.approx(TORQUE_NOISE_Nm / np.sqrt(SHORT), rel=0.15)
    assert abs(came.t_s - 12.0) < 1.0
    assert (went.effect, went.gone) == ("coulomb_friction", True)
    assert abs(went.t_s - 50.0) < 1.0


@pytest.mark.slow
def test_the_journal_says_it_too(friction: RunOutcome) -> None:
    changes = [(change.what, change.path) for change in read_journal(friction.folder.journal) if change.what != "set"]
    told = [change for change in changes if change[0] in ("effect_named", "effect_gone", "model_applied")]
    path = "coulomb_friction.axis2"
    assert told == [
        ("effect_named", path),
        ("model_applied", path),
        ("effect_gone", path),
        ("model_applied", path),
    ]


@pytest.mark.slow
def test_the_true_tension_is_held_with_the_friction_in_the_model(friction: RunOutcome) -> None:
    recording = read_recording(friction.folder.recording)
    time_s, off_N = recording.time_s, np.asarray(recording["F_true_N"]) - np.asarray(recording["F_sim_N"])
    with_friction_in_the_model = (time_s > 40.0) & (time_s < 49.9)
    assert abs(off_N[with_friction_in_the_model].mean()) < 0.3


def test_what_is_found_can_be_a_criterion_only_where_something_looks_for_it() -> None:
    changed = ["twin.live_diagnosis=null"]
    loaded = load_with_overrides(CONFIGS / "live_friction.yaml", changes=changed)
    with pytest.raises(UnusableInputError, match="beside which nothing is diagnosed"):
        check_experiment(loaded)


def test_a_criterion_on_no_effect_of_the_vocabulary_is_refused() -> None:
    loaded = load_with_overrides(CONFIGS / "live_friction.yaml")
    criterion = loaded.config.criteria[0].model_dump()
    with pytest.raises(ValueError, match="is not known"):
        type(loaded.config.criteria[0]).model_validate({**criterion, "metric": "found.no_such_effect.axis2.t_s"})
