"""What is said of a quantity's course over days: trends that are there, none that are not, changes, limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hilbench.apps.history.trend import Trend, trend

Array = NDArray[np.float64]
SEEDS = range(12)


def runs(seed: int, days: int, *, stated: float = 0.004, repeat: float = 0.01) -> tuple[Array, Array, Array]:
    """Times of one to three runs a day, a relative deviation from one's mean, and what is stated of it."""
    rng = np.random.default_rng(seed)
    per_day = rng.integers(1, 4, days)
    t = np.sort(np.concatenate([day + rng.uniform(0.3, 0.7, count) for day, count in enumerate(per_day)]))
    return t, np.hypot(stated, repeat) * rng.standard_normal(len(t)), np.full(len(t), stated)


def of(seed: int, days: int, course: object = lambda t: 0.0 * t, limit: float | None = None) -> Trend:
    t, off, stated = runs(seed, days)
    found = trend(t, 8.0 * (1.0 + course(t) + off), 8.0 * stated, limit=limit)  # type: ignore[operator]
    assert found is not None
    return found


def test_what_grows_by_a_percent_a_day_is_reported_within_a_week() -> None:
    found = [of(seed, 7, lambda t: 0.01 * t) for seed in SEEDS]
    assert sum(each.direction == "rising" for each in found) >= 11
    assert sum(each.rate_ci95[0] <= 0.08 <= each.rate_ci95[1] for each in found) >= 11


def test_what_stays_has_no_trend_and_its_level_is_in_the_interval() -> None:
    found = [of(seed, 14) for seed in SEEDS]
    assert sum(each.direction is not None for each in found) <= 1
    assert sum(each.level_ci95[0] <= 8.0 <= each.level_ci95[1] for each in found) >= 11


def test_a_part_that_was_exchanged_is_a_change_and_no_trend() -> None:
    found = [of(seed, 20, lambda t: -0.1 * (t > 9.0)) for seed in SEEDS]
    assert sum(each.direction is not None for each in found) <= 1
    for each in found:
        (step,) = (change for change in each.changes if change.kind == "step")
        assert 8.0 < step.after_d < 9.0 < step.before_d < 10.0
        assert abs(step.size + 0.8) < 4.0 * step.sd


def test_wear_goes_on_after_a_part_was_exchanged() -> None:
    found = of(1, 24, lambda t: 0.01 * t - 0.12 * (t > 12.0))
    assert found.direction == "rising"
    assert found.rate_per_d == pytest.approx(0.08, rel=0.3)


def test_a_single_run_that_is_off_is_no_trend() -> None:
    t, off, stated = runs(3, 10)
    off[-1] += 0.15
    found = trend(t, 8.0 * (1.0 + off), 8.0 * stated)
    assert found is not None
    assert found.direction is None
    assert found.level_ci95[0] < 8.02, "whether it stays so is not known yet"
    later = trend(np.append(t, 11.0), 8.0 * np.append(1.0 + off, 1.0), 8.0 * np.append(stated, 0.004))
    assert later is not None
    assert [change.kind for change in later.changes] == ["outlier"]
    assert later.level == pytest.approx(8.0, rel=0.01)


def test_when_a_limit_is_reached_is_in_its_interval() -> None:
    held = 0
    for seed in SEEDS:
        ahead = of(seed, 14, lambda t: 0.01 * t, limit=9.6).reached
        assert ahead is not None
        assert of(seed, 14, lambda t: 0.01 * t, limit=7.0).reached is None  # nothing moves towards it
        last = runs(seed, 14)[0][-1]
        held += ahead.from_d <= 20.0 - last <= ahead.to_d
        assert ahead.from_d <= ahead.median_d <= ahead.to_d
    assert held >= 9


def test_of_a_day_there_is_no_trend() -> None:
    assert trend([0.0], [1.0], [0.1]) is None
    assert trend([0.0, 0.0], [1.0, 2.0], [0.1, 0.1]) is None
    few = trend([0.0, 0.4, 0.8], [1.0, 2.0, 3.0], [0.01] * 3)
    assert few is not None
    assert few.direction is None


def test_what_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        trend([0.0, 1.0], [1.0, float("nan")], [0.1, 0.1])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([1e-9, 1.0, 1e12]), st.floats(-5.0, 5.0), st.sampled_from([1.0, -1.0]))
def test_neither_unit_nor_offset_nor_sign_change_what_is_said(
    seed: int, unit: float, offset: float, sign: float
) -> None:
    t, off, stated = runs(seed, 8)
    plain = trend(t, off, stated)
    other = trend(t + 100.0, sign * unit * (off + offset), unit * stated)
    assert plain is not None
    assert other is not None
    assert other.rate_per_d == pytest.approx(sign * unit * plain.rate_per_d, rel=1e-5, abs=1e-9 * unit)
    assert other.sure == pytest.approx(plain.sure, abs=1e-6)
    assert (other.direction is None) == (plain.direction is None)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.floats(-1e3, 1e3), st.floats(0.0, 10.0)), min_size=2, max_size=12))
def test_whatever_the_runs_say_the_answer_is_finite(given: list[tuple[int, float, float]]) -> None:
    days, values, deviations = zip(*given, strict=True)
    found = trend(days, values, deviations, limit=2e3, ahead_d=5.0)
    if found is None:
        assert len(set(days)) == 1
        return
    assert np.all(np.isfinite([found.level, found.rate_per_d, *found.level_ci95, *found.rate_ci95, found.sure]))
    assert np.all(found.band_low <= found.band_high)
    assert found.level_ci95[0] <= found.level_ci95[1]
