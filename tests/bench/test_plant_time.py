"""How far the simulated hardware goes between SYNCs that its process reads at odd times; the clock is set by hand."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable

import pytest

from hilbench.hardware.plant_time import ByClock

MS = 1_000_000


def samples_at_syncs(cycle_ms: int, read_late_ms: Callable[[int], float], periods: int, rate: float = 1.0) -> list[int]:
    """Sample times (1 ms) that the plant has gone at each SYNC; the loop turns every 2 ms between them."""
    now_ns, gone, found = 10**12, 0, []
    time = ByClock(cycle_ms * 1e-3, 1e-3, lambda: now_ns, lambda text: None)
    for number in range(periods):
        read_ns = 10**12 + round((number * cycle_ms * rate + read_late_ms(number)) * MS)
        while read_ns - now_ns > 2 * MS:
            now_ns += 2 * MS
            gone += time.without_sync(0.002)
        now_ns = read_ns
        gone += time.before_sync(0)
        found.append(gone)
        gone += time.after_sync()
    return found


@pytest.mark.parametrize(("cycle_ms", "jitter_ms"), [(2, 0.5), (10, 2.0), (20, 4.0)])
def test_every_period_of_the_config_is_as_many_sample_times_however_late_sync_is_read(
    cycle_ms: int, jitter_ms: float
) -> None:
    late = random.Random(3)
    at = samples_at_syncs(cycle_ms, lambda number: late.uniform(0.0, jitter_ms), 1000)
    assert [later - one for one, later in itertools.pairwise(at)] == [cycle_ms] * 999


def test_a_first_sync_that_was_read_late_is_made_up_for_once() -> None:
    """The process of the hardware was still busy; it takes some periods, then the steps are even."""
    at = samples_at_syncs(20, lambda number: 9.0 if number == 0 else 1.0, 500)
    steps = [later - one for one, later in itertools.pairwise(at)]
    assert sum(step != 20 for step in steps) <= 8
    assert steps[-300:] == [20] * 300


@pytest.mark.parametrize("rate", [1.003, 0.997])
def test_a_sync_that_is_off_by_more_than_clocks_are_is_not_followed(rate: float) -> None:
    at = samples_at_syncs(20, lambda number: 0.0, 2000, rate)
    assert at[-1] - at[0] == pytest.approx(1999 * 20 * rate, abs=10)


def test_a_plant_of_any_sample_time_goes_one_period_for_each_sync_however_late_it_is_read() -> None:
    now_ns, late = 10**12, random.Random(3)
    time = ByClock(0.002, 1e-3, lambda: now_ns, lambda text: None, any_period=True)
    elapsed_s, at = 0.0, []
    for number in range(2000):
        now_ns = 10**12 + round((2.5 * number + late.uniform(0.0, 0.5)) * MS)
        elapsed_s += time.before_sync(0) * time.sample_s
        at.append(elapsed_s)
        elapsed_s += time.after_sync() * time.sample_s
    steps_ms = [1e3 * (later - one) for one, later in itertools.pairwise(at[100:])]
    assert steps_ms == pytest.approx([2.5] * len(steps_ms), rel=0.01)
    assert 1e3 * (at[-1] - at[100]) == pytest.approx(2.5 * len(steps_ms), rel=1e-3)


def test_a_plant_of_any_sample_time_keeps_to_the_clock_whatever_is_lost_or_read_in_a_bunch() -> None:
    now_ns, odd = 10**12, random.Random(5)
    time = ByClock(0.002, 1e-3, lambda: now_ns, lambda text: None, any_period=True)
    elapsed_s = read_ms = 0.0
    for number in range(4000):
        if odd.random() < 0.1:
            continue  # lost
        read_ms = max(read_ms + 0.01, 2.5 * number + (odd.uniform(0.0, 9.0) if odd.random() < 0.3 else 0.1))
        now_ns = 10**12 + round(read_ms * MS)
        elapsed_s += time.before_sync(0) * time.sample_s
        elapsed_s += time.after_sync() * time.sample_s
    assert elapsed_s == pytest.approx(4000 * 0.0025, rel=2e-3)
