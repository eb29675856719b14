"""A web that tears, slips or hangs slack in one section of a line with dancers or reels is told there, nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tiers import slow
from tests.twin.beside_stations import BesideStations, beside, dancer_line, winding_line
from tests.twin.independent_dancer import IndependentDancer
from tests.twin.independent_winding import IndependentWinding

from hilbench.estimation.problems import Problem

#: Until a break is to be told: two blocks of 20 ms, and what of a third has begun before.
WITHIN_S = 0.08


def told(line: BesideStations) -> dict[int, Problem]:
    """What the twin says is wrong, by span."""
    return {span: problem for span, problem in line.twin.problems.items() if problem is not None}


def first_told(line: BesideStations, until_s: float, *speeds_m_s: float) -> tuple[float, dict[int, Problem]]:
    """After how long the twin says first that something is wrong, and what; inf and nothing if it does not."""
    begin_s = line.time_s
    while line.time_s < until_s:
        line.go(line.time_s + 0.002, *speeds_m_s)
        if found := told(line):
            return line.time_s - begin_s, found
    return np.inf, {}


@pytest.mark.parametrize("section", [1, 2])
def test_a_web_that_tears_between_reels_is_told_in_its_section(section: int) -> None:
    true = IndependentWinding((0.25, 0.15, 0.12))
    line = BesideStations(true, winding_line(), winding_line(), measured=("unwinder", "rewinder"))
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=0.8)
    assert first_told(line, 1.3, 1.0, 1.0, 1.0) == (np.inf, {})
    true.modulus_Pa = np.where(np.arange(1, 3) == section, 0.0, 2e8)
    after_s, found = first_told(line, 1.6, 1.0, 1.0, 1.0)
    assert found == {section: Problem.WEB_BREAK}
    assert after_s <= WITHIN_S
    line.go(line.time_s + 0.2, 1.0, 1.0, 1.0)
    assert told(line) == found


def test_a_web_that_tears_beside_a_dancer_is_told_there() -> None:
    line = beside(dancer_line(), dancer_line())
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=0.8)
    assert told(line) == {}
    line.line.set_parameter("span2.youngs_modulus_Pa", 1.0)
    after_s, found = first_told(line, 1.3, 1.0, 1.0, 1.0)
    (span,) = found
    assert found == {span: Problem.WEB_BREAK}
    assert span <= 2
    assert after_s <= WITHIN_S


@pytest.mark.parametrize(("factor", "within"), [(0.65, 0.025), (1.2, 0.01), *slow((0.85, 0.01), (1.5, 0.015))])
def test_another_web_is_no_torn_one_and_is_found(factor: float, within: float) -> None:
    line = beside(dancer_line(), dancer_line())
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=0.8)
    for span in (3, 4):
        line.line.set_parameter(f"span{span}.youngs_modulus_Pa", factor * 8.7e9)
    assert first_told(line, 1.8, 1.0, 1.0, 1.0) == (np.inf, {})
    found = line.table()
    assert found["E4_sim_Pa"][found["t_s"] > 1.5] == pytest.approx(factor * 8.7e9, rel=within)
    late = found["t_s"] > 1.4
    assert np.max(np.abs(found["F4_sim_N"] - found["F4_true_N"])[late]) < 1.0


def test_a_section_whose_rollers_push_its_web_hangs_slack() -> None:
    line = beside(dancer_line(), dancer_line())
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=0.8)
    after_s, found = first_told(line, 3.0, 1.0, 1.0, 0.99)
    assert found == {4: Problem.SLACK}
    assert line.line.outputs()["F4_N"] < 5.0
    line.go(line.time_s + 1.0, 1.0, 1.0, 1.01)
    assert told(line) == {}
    assert after_s > 0.1


#: Way of the web, in lengths of the section, within which a slip is to be told: one to judge it, and what it takes to
#: see that something changes.
_SLIP_WITHIN = 1.5


def assert_taken_back(line: BesideStations, slips_s: float, told_s: float, *spans: int) -> None:
    """What was booked as E from `slips_s` on is no more from `told_s` on; the tensions of the spans are right."""
    found = line.table()
    before, after = found["t_s"] < slips_s, found["t_s"] > told_s + 0.01
    settled = found["t_s"] > told_s + 1.0
    last = spans[-1]
    modulus_Pa, deviation_Pa = found[f"E{last}_sim_Pa"], found[f"E{last}_sd_Pa"]
    assert modulus_Pa[after] == pytest.approx(modulus_Pa[before][-1], rel=0.002)
    assert np.ptp(modulus_Pa[after]) == 0.0
    # Time goes on, in which E may change as ever.
    assert np.all(np.diff(deviation_Pa[after]) >= 0.0)
    # As known as before the slip can have begun, some lengths of web ago.
    assert 0.9 * deviation_Pa[before][-1] < deviation_Pa[after][0] < 1.1 * deviation_Pa[found["t_s"] > 0.5][0]
    for span in spans:
        off_N = (found[f"F{span}_sim_N"] - found[f"F{span}_true_N"])[settled]
        assert np.max(np.abs(off_N)) < 2.0
        assert abs(np.mean(off_N)) < 1.0


@pytest.mark.slow
def test_a_web_that_slips_behind_a_guide_roller_is_told_in_its_section() -> None:
    line = beside(dancer_line(), dancer_line())
    line.go(1.0, 2.0, 2.0, 2.0, ramp_s=0.8)
    assert first_told(line, 2.5, 2.0, 2.0, 2.0) == (np.inf, {})
    line.line.set_effect("web_slip", section=4, creep_per_N=2e-5)
    after_s, found = first_told(line, 7.0, 2.0, 2.0, 2.0)
    assert found == {4: Problem.SLIP}
    assert 1.0 < after_s * 2.0 / (2.0 + 3.0) < _SLIP_WITHIN
    line.go(line.time_s + 3.0, 2.0, 2.0, 2.0)
    assert told(line) == found
    assert_taken_back(line, 2.5, 2.5 + after_s, 4)


def test_a_press_over_which_the_web_slips_is_told_by_the_section_before_it() -> None:
    true = IndependentWinding((0.25, 0.15, 0.12), held=True)
    line = BesideStations(true, winding_line(), winding_line(), measured=("unwinder", "rewinder"))
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=0.8)
    assert first_told(line, 2.5, 1.0, 1.0, 1.0) == (np.inf, {})
    true.slip = np.array([0.0, 6e-4, 0.0])
    after_s, found = first_told(line, 6.0, 1.0, 1.0, 1.0)
    assert found == {1: Problem.SLIP}
    assert 1.0 < after_s * 1.0 / 2.0 < _SLIP_WITHIN
    line.go(line.time_s + 3.0, 1.0, 1.0, 1.0)
    assert_taken_back(line, 2.5, 2.5 + after_s, 1, 2)


@pytest.mark.parametrize("factor", [0.7, *slow(0.85, 1.4)])
def test_another_web_is_no_slip_as_it_goes_through(factor: float) -> None:
    line = beside(dancer_line(), dancer_line())
    line.go(1.0, 2.0, 2.0, 2.0, ramp_s=0.8)
    for span in (3, 4):
        line.line.set_parameter(f"span{span}.youngs_modulus_Pa", factor * 8.7e9)
    assert first_told(line, 5.0, 2.0, 2.0, 2.0) == (np.inf, {})


@pytest.mark.slow
def test_speeds_and_tensions_that_change_are_no_slip() -> None:
    line = beside(dancer_line(0.9 * 8.7e9), dancer_line())
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=0.8)
    for speeds in ((1.0, 1.0, 1.0002), (2.0, 2.0, 2.0004), (2.0, 2.0, 2.0), (1.0, 1.0, 1.0)):
        begin_s = line.time_s
        while line.time_s < begin_s + 3.0:
            line.go(min(line.time_s + 1.0, begin_s + 3.0), *speeds, ramp_s=0.8)
            assert told(line) == {}


def lies_N(slip: float) -> float:
    """What the encoders add to the tension of a section of 5 m at 2 m/s in two windows of 30 ms, of which torques tell
    the means."""
    return abs(slip) * 2.0 / 5.0 * 8.7e9 * 0.5 * 65e-6 * 0.06


@pytest.mark.parametrize(("roller", "slip"), [(2, 1e-3), *slow((2, 2e-3), (0, -1e-3), (0, 2e-3), (2, -1.5e-3))])
def test_a_roller_beside_a_measured_dancer_that_loses_web_is_told_in_the_dancers_section(
    roller: int, slip: float
) -> None:
    """Of 4 m at 2 m/s, by more than strain, 2.8e-4, can be: from a quarter of a length on."""
    true = IndependentDancer()
    line = BesideStations(true, dancer_line(), dancer_line(), measured=("dancer",))  # type: ignore[arg-type]
    line.go(1.0, 2.0, 2.0, 2.0, ramp_s=0.8)
    assert first_told(line, 2.5, 2.0, 2.0, 2.0) == (np.inf, {})
    true.slip = np.where(np.arange(5) == roller, slip, 0.0)
    after_s, found = first_told(line, 5.0, 2.0, 2.0, 2.0)
    assert found == {1: Problem.SLIP}
    assert after_s < 1.3
    line.go(line.time_s + 1.5, 2.0, 2.0, 2.0)
    assert told(line) == found
    rows = line.table()
    since_told = rows["t_s"] > 2.5 + after_s + 0.01
    assert rows["E4_sim_Pa"][since_told] == pytest.approx(8.7e9, rel=0.01)
    settled = rows["t_s"] > 2.5 + after_s + 0.5
    assert np.max(np.abs(rows["x_dancer_sim_m"] - rows["x_dancer_true_m"])[settled]) < 4e-4
    assert np.max(np.abs(rows["F4_sim_N"] - rows["F4_true_N"])[settled]) < lies_N(slip)


@pytest.mark.parametrize("factor", slow(0.65, 1.2, 1.5))
def test_another_web_beside_a_measured_dancer_loses_nothing(factor: float) -> None:
    true = IndependentDancer()
    line = BesideStations(true, dancer_line(), dancer_line(), measured=("dancer",))  # type: ignore[arg-type]
    line.go(1.0, 2.0, 2.0, 2.0, ramp_s=0.8)
    line.go(2.0, 2.0, 2.0, 2.0)
    true.modulus_Pa = np.where(np.arange(4) < 2, factor * 8.7e9, 8.7e9)
    assert first_told(line, 3.0, 2.0, 2.0, 2.0) == (np.inf, {})
    # The dancer goes, and comes back, as its section gets more web than leaves it.
    assert first_told(line, 3.5, 2.02, 2.0, 2.0) == (np.inf, {})
    line.go(4.0, 1.0, 1.0, 1.0, ramp_s=0.5)
    assert first_told(line, 5.0, 0.99, 1.0, 1.0) == (np.inf, {})


@pytest.mark.slow
def test_encoders_that_promise_a_slack_web_where_it_pulls_tell_a_slip() -> None:
    true = IndependentDancer()
    line = BesideStations(true, dancer_line(), dancer_line())  # type: ignore[arg-type]
    line.go(1.0, 2.0, 2.0, 2.0, ramp_s=0.8)
    assert first_told(line, 2.5, 2.0, 2.0, 2.0) == (np.inf, {})
    true.slip = np.array([0.0, 0.0, 0.0, 0.0, -5e-3])
    after_s, found = first_told(line, 3.0, 2.0, 2.0, 2.0)
    assert found == {4: Problem.SLIP}
    assert after_s < 0.4
    line.go(line.time_s + 1.0, 2.0, 2.0, 2.0)
    rows = line.table()
    settled = rows["t_s"] > 2.5 + after_s + 0.2
    assert np.min(rows["F4_true_N"][settled]) > 90.0
    assert np.max(np.abs(rows["F4_sim_N"] - rows["F4_true_N"])[settled]) < lies_N(5e-3)


@pytest.mark.slow
def test_tensions_stay_as_E_that_was_a_slip_is_taken_back() -> None:
    """Of a slip of 0.1 % E is booked as another one, until it is told."""
    true = IndependentDancer()
    line = BesideStations(true, dancer_line(), dancer_line(), measured=("dancer",))  # type: ignore[arg-type]
    line.go(1.0, 2.0, 2.0, 2.0, ramp_s=0.8)
    line.go(4.0, 2.0, 2.0, 2.0)
    true.slip = np.array([0.0, 0.0, 0.0, 0.0, 1e-3])
    after_s, found = first_told(line, 8.0, 2.0, 2.0, 2.0)
    assert found == {4: Problem.SLIP}
    line.go(line.time_s + 0.8, 2.0, 2.0, 2.0)
    rows = line.table()
    assert np.min(rows["E4_sim_Pa"]) < 0.95 * 8.7e9
    since_told = rows["t_s"] > 4.0 + after_s + 0.05
    assert rows["E4_sim_Pa"][since_told] == pytest.approx(8.7e9, rel=0.01)
    for span in (1, 4):
        assert np.max(np.abs(rows[f"F{span}_sim_N"] - rows[f"F{span}_true_N"])[since_told]) < lies_N(1e-3)
