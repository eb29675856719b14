"""Criteria as a config states them, and their verdicts."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from hilbench.runs.criteria import Criterion, evaluate


def criterion(**fields: Any) -> Criterion:
    return Criterion.model_validate({"name": "E found", "metric": "E_time_to_1pct_s", **fields})


@pytest.mark.parametrize(
    ("bound", "value", "limit", "passed"),
    [
        ({"max": 25}, 25.0, "≤ 25", True),
        ({"max": 25}, 25.001, "≤ 25", False),
        ({"min": 3}, 3.0, "≥ 3", True),
        ({"min": 3}, 2.9, "≥ 3", False),
        ({"min": 3, "max": 5}, 4.0, "3 … 5", True),
        ({"min": 3, "max": 5}, 5.5, "3 … 5", False),
        ({"target": 20, "tolerance": 5}, 15.0, "20 ± 5", True),
        ({"target": 20, "tolerance": 5}, 14.9, "20 ± 5", False),
        ({"target": 0, "tolerance": 5e-6}, 1e-6, "0 ± 5e-6", True),
        ({"target": -20, "tolerance": 5}, -24.0, "-20 ± 5", True),
    ],
)
def test_bounds(bound: dict[str, float], value: float, limit: str, passed: bool) -> None:
    (result,) = evaluate([criterion(**bound, unit="s")], {"E_time_to_1pct_s": value})
    assert result.model_dump() == {"name": "E found", "value": value, "limit": limit, "unit": "s", "passed": passed}


@pytest.mark.parametrize(
    ("metrics", "reason"),
    [
        ({}, "metric E_time_to_1pct_s was not evaluated in this run"),
        ({"E_time_to_1pct_s": None}, "nothing stepped, or signals that it needs are not recorded"),
        ({"E_time_to_1pct_s": math.nan}, "is nan, expected a finite number"),
        ({"E_time_to_1pct_s": math.inf}, "is inf, expected a finite number"),
    ],
)
def test_a_metric_that_is_not_there_fails_and_says_why(metrics: dict[str, float | None], reason: str) -> None:
    (result,) = evaluate([criterion(max=25)], metrics)
    assert not result.passed
    assert result.value is None
    assert reason in (result.reason or "")
    assert result.model_dump()["reason"] == result.reason


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, "either min and/or max, or target and tolerance"),
        ({"max": 25, "target": 20, "tolerance": 1}, "either min and/or max, or target and tolerance"),
        ({"target": 20}, "target and tolerance together"),
        ({"tolerance": 20}, "target and tolerance together"),
        ({"target": 20, "tolerance": -1}, "greater than or equal to 0"),
        ({"min": 5, "max": 3}, "min 5 at most max 3"),
        ({"max": 25, "metric": "E_tiem_s"}, "metric 'E_tiem_s' is not known, expected one of E_time_to_1pct_s, "),
        (
            {"max": 1, "metric": "cycles_missed", "step": 1},
            "no step with metric cycles_missed, which is of the whole run",
        ),
        ({"max": 25, "step": 0}, "greater than or equal to 1"),
        ({"max": 25, "unit": "ms"}, "unit 'ms' of metric E_time_to_1pct_s, which is in 's'"),
        ({"max": math.inf}, "finite number"),
        ({"max": 25, "maximum": 3}, "Extra inputs are not permitted"),
    ],
)
def test_a_criterion_that_says_nothing_clear_is_refused(fields: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValidationError) as caught:
        criterion(**fields)
    assert expected in str(caught.value)


def test_results_stand_in_the_order_of_the_criteria() -> None:
    criteria = [criterion(name="b", max=1), criterion(name="a", metric="E_noise_pct", max=1)]
    assert [result.name for result in evaluate(criteria, {})] == ["b", "a"]
