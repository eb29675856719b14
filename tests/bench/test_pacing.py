"""Pacing by absolute deadlines, on times of our own."""

import itertools

from hypothesis import given
from hypothesis import strategies as st
from tests.bench.whole_runs import config, run_folders
from tests.cli.in_process import hilbench

from hilbench.exchange import pacing
from hilbench.exchange.pacing import Pacing, advance, advance_in_step, start
from hilbench.results.result import Result

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
def test_beside_those_who_wait_whole_periods_are_missed_and_no_sync_comes_within_less_than_it_was_late(delays):
    pacing = Pacing(PERIOD)
    start(pacing, 0)
    sent_ns = [pacing.deadline_ns - PERIOD]
    for delay in delays:
        sent_ns.append(pacing.deadline_ns + delay)
        advance_in_step(pacing, sent_ns[-1])
    assert pacing.missed == sum(delay // PERIOD for delay in delays)
    assert list(pacing.lateness_ns) == delays
    late = [0, *delays]
    for before, after, was_late in zip(sent_ns, sent_ns[1:], late, strict=False):
        assert after - before >= (PERIOD if was_late >= PERIOD else PERIOD - was_late)


def test_a_run_in_one_process_that_is_slower_than_the_clock_says_so_and_fails_its_criterion(tmp_path, monkeypatch):
    """Every hundredth SYNC comes two cycles and a half late."""
    sleep_until, calls = pacing.sleep_until, itertools.count(1)

    def held_up(deadline_ns):
        return sleep_until(deadline_ns) + (5 * PERIOD // 2 if next(calls) % 100 == 0 else 0)

    monkeypatch.setattr(pacing, "sleep_until", held_up)
    steps = [{"hold": {"duration_s": 0.5}}]
    criteria = [{"name": "in time", "metric": "cycles_missed", "max": 0.0}]
    path = config(tmp_path, pace="realtime", steps=steps, criteria=criteria)
    done = hilbench("run", path, "--in-process", "--no-report", "--out", tmp_path / "runs")
    assert done.returncode == 1
    (folder,) = run_folders(path)
    timing = Result.read(folder / "result.json").timing
    assert timing.missed >= 2 * (timing.cycles // 100)
    assert f"{timing.missed} missed" in done.stdout
