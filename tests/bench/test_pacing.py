"""Pacing by absolute deadlines, on times of our own."""

from hypothesis import given
from hypothesis import strategies as st

from hilbench.exchange.pacing import Pacing, advance, advance_in_step, start

PERIOD = 2_000_000


def test_deadlines_stay_on_their_grid_when_a_cycle_is_a_little_late():
    pacing = Pacing(PERIOD)
    start(pacing, 0)
    advance(pacing, PERIOD + 300_000)
    assert (pacing.deadline_ns, pacing.missed, list(pacing.lateness_ns)) == (2 * PERIOD, 0, [300_000])


def test_a_whole_period_late_counts_as_missed_and_is_not_made_up_for():
    pacing = Pacing(PERIOD)
    start(pacing, 0)
    advance(pacing, PERIOD + 3 * PERIOD + 1)
    assert pacing.missed == 3
    assert pacing.deadline_ns == 5 * PERIOD


@given(st.lists(st.integers(min_value=0, max_value=5 * PERIOD), min_size=1, max_size=50))
def test_every_period_is_either_sent_or_missed(delays):
    pacing = Pacing(PERIOD)
    start(pacing, 0)
    for delay in delays:
        advance(pacing, pacing.deadline_ns + delay)
    assert pacing.deadline_ns == PERIOD * (1 + len(delays) + pacing.missed)
    assert len(pacing.lateness_ns) == len(delays)


@given(st.lists(st.integers(min_value=0, max_value=5 * PERIOD), min_size=1, max_size=50))
def test_beside_those_who_wait_nothing_is_missed_and_no_sync_comes_within_less_than_it_was_late(delays):
    pacing = Pacing(PERIOD)
    start(pacing, 0)
    sent_ns = [pacing.deadline_ns - PERIOD]
    for delay in delays:
        sent_ns.append(pacing.deadline_ns + delay)
        advance_in_step(pacing, sent_ns[-1])
    assert pacing.missed == 0
    assert list(pacing.lateness_ns) == delays
    late = [0, *delays]
    for before, after, was_late in zip(sent_ns, sent_ns[1:], late, strict=False):
        assert after - before >= (PERIOD if was_late >= PERIOD else PERIOD - was_late)
