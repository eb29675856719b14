"""Positions of several axes that are of one instant, and those that are not."""

from __future__ import annotations

from math import cos, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.plant.sample_coherence import OwnIncrements, SampleCoherence, play

WAY_M = 0.006  #: of a cycle, 2 ms at 3 m/s


@pytest.mark.parametrize("late", [0, 1, 2])
def test_positions_of_which_one_is_a_cycle_old_are_of_no_instant(late: int) -> None:
    pairing = SampleCoherence(1e-4)
    assert pairing.update(0.0, 0.0, 0.0)
    assert pairing.update(WAY_M, 1.0001 * WAY_M, 0.9999 * WAY_M)
    now = [2.0 * WAY_M] * 3
    now[late] = WAY_M
    assert not pairing.update(*now)
    assert pairing.update(3.0 * WAY_M, 3.0 * WAY_M, 3.0 * WAY_M)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_position_that_is_no_number_is_of_no_instant(place: int) -> None:
    pairing = SampleCoherence(1e-4)
    pairing.update(0.0, 0.0, 0.0)
    now = [WAY_M] * 3
    now[place] = nan
    assert not pairing.update(*now)


def test_axes_that_stand_may_differ_by_the_least_way() -> None:
    for least_travel_m, alike in ((1e-4, True), (1e-5, False)):
        pairing = SampleCoherence(least_travel_m)
        pairing.update(0.0, 0.0)
        assert pairing.update(0.0, 5e-5) is alike


def test_after_cycles_that_nobody_has_counted_a_position_that_is_a_cycle_old_is_still_told() -> None:
    pairing = SampleCoherence(1e-4)
    for cycle in range(3):
        assert pairing.update(cycle * WAY_M, cycle * WAY_M)
    assert not pairing.update(7.0 * WAY_M, 8.0 * WAY_M)
    assert all(pairing.update(cycle * WAY_M, 1.0001 * cycle * WAY_M) for cycle in range(9, 20))


def test_a_line_that_speeds_up_from_rest_is_followed() -> None:
    pairing = SampleCoherence(1e-5)
    travels = [5.0 * (0.002 * cycle) ** 2 / 2.0 for cycle in range(400)]
    assert all(pairing.update(way, 1.0005 * way) for way in travels)


def test_a_film_whose_rollers_differ_is_followed_after_samples_that_were_sent_twice() -> None:
    """Rollers of a film at 3 m/s and 10 ms differ by 0.2 %; a busy machine sends samples of 3, 0, 0, 4, 0 cycles."""
    pairing = SampleCoherence(2e-4)
    cycles, refused = 0, 0
    for gone in [1] * 20 + [0, 3, 0, 0, 4, 0] + [1] * 10:
        cycles += gone
        refused = 0 if pairing.update(1.002 * 0.03 * cycles, 0.03 * cycles) else refused + 1
    assert refused == 0


def test_positions_of_which_one_is_a_third_of_a_cycle_old_are_of_no_instant() -> None:
    pairing, travel_m = SampleCoherence(2e-4), 0.02
    assert all(pairing.update(1.001 * travel_m * cycle, travel_m * cycle) for cycle in range(40))
    assert not pairing.update(1.001 * travel_m * 41, travel_m * 40.7)
    assert pairing.update(1.001 * travel_m * 42, travel_m * 42)


def test_a_roller_that_a_soft_web_pulls_back_at_the_start_is_followed() -> None:
    """The last of three rollers gives way by 0.44 mm in 76 ms while the line begins to move, and comes back."""
    pairing, cycle_s = SampleCoherence(3.2e-5), 0.004
    for cycle in range(100):
        t_s = cycle * cycle_s
        pulled_m = 2.2e-4 * (1.0 - cos(pi * t_s / 0.076)) if t_s < 0.152 else 0.0
        way_m = 0.077 * t_s**2
        assert pairing.update(way_m, way_m, way_m - pulled_m), cycle


@pytest.mark.parametrize("speed_m_s", [0.0, 0.1, 3.0])
def test_an_axis_that_is_left_behind_for_good_is_followed_after_some_cycles(speed_m_s: float) -> None:
    pairing, cycle_s, accepted = SampleCoherence(2e-5), 0.002, list[bool]()
    for cycle in range(400):
        way_m = speed_m_s * cycle * cycle_s
        behind_m = 0.2 * max(cycle - 200, 0) * cycle_s
        accepted.append(pairing.update(way_m, way_m - behind_m))
    assert all(accepted[:200])
    assert accepted.count(False) <= 6
    assert all(accepted[210:])


def test_an_axis_whose_samples_are_a_cycle_late_for_good_is_refused_at_any_speed() -> None:
    pairing, cycle_s = SampleCoherence(2e-5), 0.002

    def way_m(cycle: int) -> float:
        return 0.1 * cycle * cycle_s if cycle < 500 else 0.1 + 0.1 * (cycle - 500) * cycle_s + ramp_m(cycle - 500)

    def ramp_m(cycle: int) -> float:
        return 0.5 * (min(cycle, 1500) * cycle_s) ** 2 + 3.0 * max(cycle - 1500, 0) * cycle_s

    accepted = [pairing.update(way_m(k), way_m(k - (k >= 300))) for k in range(1, 2500)]
    assert all(accepted[:298])
    assert not any(accepted[300:])


#: What comes of a stretch of cycles: nothing; the same sample again; that of an axis again.
NOTHING, ALL_OLD, FIRST_OLD, SECOND_OLD = range(4)


@given(
    st.lists(st.tuples(st.integers(3, 60), st.integers(1, 14), st.sampled_from(range(4))), min_size=1, max_size=12),
    st.floats(0.0, 0.03),
    st.sampled_from([(0.03, 2e-4), (0.003, 2e-4), (0.006, 2e-5), (0.0002, 2e-5)]),
)
def test_what_comes_late_is_refused_and_what_follows_is_accepted(
    stretches: list[tuple[int, int, int]], draw: float, way: tuple[float, float]
) -> None:
    of_a_cycle_m, least_m = way
    pairing, cycle = SampleCoherence(least_m), 0
    for _ in range(600):
        cycle += 1
        assert pairing.update((1.0 + draw) * of_a_cycle_m * cycle, of_a_cycle_m * cycle)
    for quiet, count, what in stretches:
        before = cycle
        for k in range(count):
            cycle += 1
            first = before if what in (ALL_OLD, FIRST_OLD) else cycle
            second = before if what in (ALL_OLD, SECOND_OLD) else cycle
            if what == NOTHING:
                pairing.miss()
            else:
                accepted = pairing.update((1.0 + draw) * of_a_cycle_m * first, of_a_cycle_m * second)
                assert accepted <= (first == second), k
        refused = 0
        for _ in range(quiet):
            cycle += 1
            refused += not pairing.update((1.0 + draw) * of_a_cycle_m * cycle, of_a_cycle_m * cycle)
        assert refused <= 20
        assert refused < quiet or quiet <= 20


CYCLE_S = 0.003
#: Ways of a cycle of axes with a dancer and an accumulator between them: one of them stands.
OWN_M = (0.006, 0.0, 0.0035)


def under_way() -> OwnIncrements:
    """Two cycles on, with these ways."""
    axes = OwnIncrements(3, play("m", CYCLE_S))
    for cycles in range(3):
        assert axes.update(*(cycles * way for way in OWN_M))
    return axes


def test_axes_with_speeds_of_their_own_are_of_one_instant_when_all_have_gone_as_many_cycles() -> None:
    axes = under_way()
    assert not axes.update(3.0 * OWN_M[0], 0.0, 2.0 * OWN_M[2])
    assert axes.behind == 1
    assert axes.update(*(4.0 * way for way in OWN_M))
    assert (axes.elapsed, axes.behind) == (2, 0)


@pytest.mark.parametrize(("gone", "behind"), [(0, 1), (1, 0), (2, -1), (3, -1)])
def test_ways_say_how_many_cycles_have_gone_by_whatever_was_counted(gone: int, behind: int) -> None:
    axes = under_way()
    assert axes.update(*((2.0 + gone) * way for way in OWN_M))
    assert (axes.elapsed, axes.behind) == (gone, behind)


def test_a_sample_that_is_late_is_made_good_by_the_next() -> None:
    axes = under_way()
    axes.miss()
    assert axes.behind == 1
    assert axes.update(*(4.0 * way for way in OWN_M))
    assert (axes.elapsed, axes.behind) == (2, 0)


def test_axes_that_never_agree_are_believed_after_some_cycles() -> None:
    axes, taken = under_way(), []
    for cycles in range(3, 12):
        taken.append(axes.update(cycles * OWN_M[0], 0.0, cycles * 0.5 * OWN_M[2]))
    assert True in taken
    assert not all(taken)
