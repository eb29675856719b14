"""The experiment of a commissioning stays within what the config lets a machine do, and says why it can't be made."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.errors import UnusableInputError
from hilbench.runs.commissioning import LONGEST_S, CommissioningPlan, commissioning_plan
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"


def plan(name: str, *changes: str, forward_only: bool = False) -> CommissioningPlan:
    path = CONFIGS / f"{name}.yaml"
    return commissioning_plan(load_with_overrides(path, changes=changes).config, path, forward_only=forward_only)


def speeds(of: CommissioningPlan) -> list[float]:
    return [step.ramp.to for step in of.steps if step.ramp is not None]


@pytest.mark.parametrize(
    "name", ["web_section_step", "line_two_spans", "line_three_spans", "servo_axis", "mixed_bench"]
)
def test_a_plan_goes_both_ways_from_standstill_to_standstill_in_two_minutes(name: str) -> None:
    found = plan(name)
    assert found.duration_s <= LONGEST_S
    assert max(speeds(found)) == -min(speeds(found)) > 0.0
    assert speeds(found)[-1] == 0.0


def test_it_goes_as_fast_as_the_steps_of_the_config_and_no_faster_than_its_limits() -> None:
    assert max(speeds(plan("web_section_step"))) == 3.0
    limited = plan("web_section_step", "safety.limits.speed_m_s={warning: 2.0, trip: 2.5}")
    assert max(speeds(limited)) == pytest.approx(1.8)
    assert max(speeds(plan("servo_axis"))) == pytest.approx(35.0, rel=0.01)  # of its table


def test_every_span_with_a_loop_gets_a_second_tension_and_its_own_again() -> None:
    sets = [(step.set.path, step.set.to) for step in plan("line_two_spans").steps if step.set is not None]
    paths = {path for path, _ in sets}
    assert len(paths) == 2
    for path in paths:
        values = [to for at, to in sets if at == path]
        assert values[0] > 1.1 * values[1]
        assert values[:2] == values[2:]  # the same backwards


def test_forward_only_never_turns_back() -> None:
    assert min(speeds(plan("web_section_step", forward_only=True))) == 0.0


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("winding_line", "seed=1", "a line with 'stations'"),
        ("web_section_step", "safety.limits.tension_N={warning: 85.0, trip: 90.0}", "safety.limits.tension_N lets"),
        ("web_section_step", "safety.limits.speed_m_s={warning: 0.3, trip: 0.4}", "expected 0.52 m/s or more"),
        ("web_section_step", "machine.drives.torque_limit_Nm=0.5", "its drives take"),
    ],
)
def test_what_can_not_be_commissioned_is_said_in_one_line(name: str, change: str, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said) as caught:
        plan(name, change)
    assert str(caught.value).startswith(str(CONFIGS / f"{name}.yaml"))
    assert "\n" not in str(caught.value)
