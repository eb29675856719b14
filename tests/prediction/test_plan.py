"""What is going to be asked of a machine, as a course over time."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.prediction.plan import Asked, Move, Plan

TIMES = np.arange(0.0, 6.0, 0.5) + 10.0


def test_a_quantity_goes_on_along_its_ramp_and_jumps_at_its_step() -> None:
    plan = Plan((Move("v", 9.0, 11.0, 4.0), Move("v", 12.0, 12.0, 1.0), Move("F", 11.0, 11.0, 90.0)))
    course = plan.course("v", 2.0, 10.0, TIMES)
    assert course[:3].tolist() == pytest.approx([2.0, 3.0, 4.0])
    assert course[3] == 4.0
    assert set(course[4:].tolist()) == {1.0}
    assert plan.course("F", 80.0, 10.0, TIMES).tolist() == [80.0] * 2 + [90.0] * 10


def test_what_is_over_does_not_count_and_what_nobody_moves_stays() -> None:
    plan = Plan((Move("v", 1.0, 9.9, 4.0),))
    assert set(plan.course("v", 4.0, 10.0, TIMES).tolist()) == {4.0}
    assert set(plan.course("other", 7.0, 10.0, TIMES).tolist()) == {7.0}


def test_a_move_that_somebody_asks_about_takes_the_place_of_those_that_were_planned() -> None:
    plan = Plan((Move("v", 11.0, 11.0, 4.0), Move("F", 11.0, 11.0, 90.0))).with_moves([Move("v", 12.0, 12.0, 5.0)])
    assert plan.course("v", 0.0, 10.0, TIMES)[-1] == 5.0
    assert plan.course("v", 0.0, 10.0, TIMES)[3] == 0.0
    assert plan.course("F", 80.0, 10.0, TIMES)[-1] == 90.0


def test_what_is_held_back_is_planned_no_higher() -> None:
    asked = Asked(plan=Plan((Move("v", 10.0, 11.0, -4.0), Move("F", 11.0, 11.0, 90.0))), ceilings={"v": 3.0})
    assert asked.course("v", 0.0, 10.0, TIMES)[:3].tolist() == pytest.approx([0.0, -2.0, -3.0])
    assert asked.course("F", 80.0, 10.0, TIMES)[-1] == 90.0


def test_what_is_asked_now_is_where_a_course_begins() -> None:
    asked = Asked({"v": 3.0}, Plan((Move("v", 10.0, 11.0, 4.0),)))
    assert asked.course("v", 0.0, 10.0, TIMES)[:3].tolist() == pytest.approx([3.0, 3.5, 4.0])
    assert asked.course("F", 80.0, 10.0, TIMES)[0] == 80.0
