"""Predicted probabilities against what came, over seeded runs; tools/prediction_calibration.py has many more."""

from __future__ import annotations

import pytest
from tools.prediction_calibration import Case, brier, reliability, run


def case(probability: float, *, crossed: bool) -> Case:
    return Case(1, "ramp", "nothing", "tau2_Nm", 1.0, probability, crossed)


def test_a_forecast_is_scored_by_how_far_it_was_from_what_came() -> None:
    assert brier([case(1.0, crossed=True), case(0.0, crossed=False)]) == 0.0
    assert brier([case(0.5, crossed=True), case(1.0, crossed=False)]) == 0.625
    assert reliability([case(0.5, crossed=True), case(0.45, crossed=False), case(1.0, crossed=True)]) == [
        (0.4, 0.6, 2, 0.475, 0.5),
        (0.95, 1.0, 1, 1.0, 1.0),
    ]


@pytest.mark.slow
def test_over_seeded_runs_the_probabilities_are_those_of_what_comes() -> None:
    cases = [run(seed) for seed in range(40, 46)]
    assert brier(cases) <= 0.05, cases
    assert {case.experiment for case in cases} == {"modulus", "set-point", "ramp"}
    assert {case.crossed for case in cases} == {True, False}


@pytest.mark.slow
def test_over_seeded_runs_of_a_servo_axis_too() -> None:
    cases = [run(seed, "servo_axis") for seed in range(1, 9)]
    assert brier(cases) <= 0.05, cases
    assert {case.experiment for case in cases} == {"ramp", "inertia", "reversal"}
    assert {case.crossed for case in cases} == {True, False}


@pytest.mark.slow
def test_over_seeded_runs_of_two_spans_too() -> None:
    cases = [run(seed, "two_spans") for seed in range(18, 26)]
    assert brier(cases) <= 0.05, cases
    assert {case.experiment for case in cases} == {"modulus", "set-point", "ramp"}
    assert {case.crossed for case in cases} == {True, False}
