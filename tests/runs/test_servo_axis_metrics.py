"""The metrics of a shaft on signals whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from tests.runs.shafts import TAU_S, COULOMB_Nm, recorded_shaft

from hilbench.runs.criteria import Criterion, evaluate
from hilbench.runs.metrics import evaluate_metrics, judge, of_steps


def test_a_step_of_the_inertia_is_judged_as_one_of_e_is_while_the_shaft_never_stops_swinging() -> None:
    judged = judge(recorded_shaft().channels)
    (step,) = judged.steps
    assert [event.kind for event in judged.events] == ["step"]  # that it swings is nothing that happened
    assert str(step.event) == "J +25 %"
    assert step.start_s == pytest.approx(8.0)
    assert step.until_s == pytest.approx(20.0)
    found = judged.metrics()
    assert found["J_time_to_1pct_s"] == pytest.approx(TAU_S * np.log(0.25 / 1.25 / 0.01), abs=0.003)
    assert found["J_overshoot_pct"] == 0
    assert found["J_final_error_pct"] == pytest.approx(0, abs=0.01)
    assert found["coulomb_final_error_pct"] == pytest.approx(2.0)
    assert found["speed_rms_error_rad_s"] == pytest.approx(0.1, rel=0.05)


def test_a_run_of_a_shaft_has_no_metrics_of_a_web() -> None:
    found = evaluate_metrics(recorded_shaft().channels)
    assert set(found) == set(of_steps()["servo_axis"].metrics)
    assert not [name for name in found if "tension" in name or name.startswith("E_")]


def test_a_step_of_the_friction_is_seen_and_named() -> None:
    channels = dict(recorded_shaft(share=0.0).channels)
    channels["coulomb_true_Nm"] = np.where(channels["t_s"] < 10, COULOMB_Nm, 1.5 * COULOMB_Nm)
    judged = judge(channels)
    assert [str(step.event) for step in judged.steps] == ["friction +50 %"]
    assert judged.metrics()["coulomb_final_error_pct"] == pytest.approx(32.0)


def test_without_a_step_the_whole_motion_is_judged() -> None:
    (window,) = judge(recorded_shaft(share=0.0).channels).steps
    assert window.event is None
    assert window.until_s - window.start_s > 19.9


def test_a_criterion_on_the_inertia_fails_where_it_is_found_too_slowly() -> None:
    criterion = Criterion.model_validate({"name": "quick", "metric": "J_time_to_1pct_s", "max": 0.5})
    judged = judge(recorded_shaft().channels)
    (result,) = evaluate([criterion], judged.metrics(), judged)
    assert result.verdict == "failed"
    assert result.value == pytest.approx(1.5, abs=0.01)


def test_a_criterion_on_a_web_says_why_a_shaft_has_none() -> None:
    criterion = Criterion.model_validate({"name": "tension", "metric": "tension_recovery_s", "max": 5})
    judged = judge(recorded_shaft().channels)
    (result,) = evaluate([criterion], judged.metrics(), judged)
    assert result.verdict == "error"
    assert result.reason is not None
    assert "tension_recovery_s" in result.reason
