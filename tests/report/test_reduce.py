"""Reduced signals keep what the eye would see."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.apps.report.reduce import (
    envelope,
    mean_velocity,
    moving_average,
    reduced,
    reduced_times,
    stretches,
    thinned,
)


def test_moving_average_of_a_ramp_is_the_ramp_and_takes_noise_out() -> None:
    ramp = np.arange(100.0)
    np.testing.assert_allclose(moving_average(ramp, 9)[4:-4], ramp[4:-4])
    np.testing.assert_allclose(moving_average(np.full(100, 3.0), 40), 3.0)
    wiggle = np.where(np.arange(1001) % 2, 1.0, -1.0)
    assert np.abs(moving_average(wiggle, 101)).max() < 0.03


def test_moving_average_keeps_a_gap_local() -> None:
    values = np.ones(100)
    values[40:60] = np.nan
    averaged = moving_average(values, 5)
    assert np.isnan(averaged[45:55]).all()
    np.testing.assert_allclose(averaged[:40], 1.0)
    assert len(moving_average([], 5)) == 0


def test_velocity_resolves_a_tenth_of_a_millimetre_a_second_behind_a_coarse_encoder() -> None:
    t = np.arange(0, 10, 0.002)
    x = np.round((3 * t + 1e-4 * np.clip(t - 5, 0, None)) / 1.2e-6) * 1.2e-6
    v = mean_velocity(t, x, 200)
    np.testing.assert_allclose(v[300:2200], 3, atol=1e-6)
    np.testing.assert_allclose(v[2800:-300], 3.0001, atol=1e-6)


def test_thinned_keeps_every_peak() -> None:
    t = np.arange(30_000.0)
    values = np.sin(t / 3000)
    values[12_345], values[20_001] = 9.0, -9.0
    x, y = thinned(t, values, 300)
    assert len(x) <= 600
    assert (y.max(), y.min()) == (9.0, -9.0)
    assert x[np.argmax(y)] == 12_345
    assert (np.diff(x) > 0).all()


def test_thinned_leaves_a_gap_where_one_is() -> None:
    values = np.ones(10_000)
    values[4000:6000] = np.nan
    x, y = thinned(np.arange(10_000.0), values, 100)
    assert np.isnan(y[(x > 4100) & (x < 5900)]).all()


@pytest.mark.parametrize("samples", [5, 700, 701, 30_001])
def test_envelope_encloses_the_signal(samples: int) -> None:
    values = np.random.default_rng(0).normal(size=samples)
    x, low, high = envelope(np.arange(float(samples)), values, 700)
    assert len(x) == len(low) == len(high) == min(samples, 700)
    assert (low.min(), high.max()) == (values.min(), values.max())
    assert (low <= high).all()


def test_an_average_sees_nothing_of_a_step_before_it() -> None:
    values = np.where(np.arange(1000) < 500, 0.0, 1.0)
    assert moving_average(values, 101)[499] > 0.4
    averaged = moving_average(values, 101, breaks=[500])
    assert not averaged[:500].any()
    assert averaged[500:] == pytest.approx(1.0)
    t = np.arange(1000) * 0.002
    x = np.where(t < 1, t, 1 + 3 * (t - 1))
    velocity = mean_velocity(t, x, 100, breaks=[500])
    assert velocity[:500] == pytest.approx(1.0)
    assert velocity[501:] == pytest.approx(3.0)


@given(
    count=st.integers(2, 3000),
    points=st.integers(20, 500),
    at=st.floats(0, 1),
    seed=st.integers(0, 1000),
)
def test_a_reduced_signal_has_every_extreme_in_its_stretch(count: int, points: int, at: float, seed: int) -> None:
    t = 0.002 * np.arange(count)
    data = np.random.default_rng(seed).normal(size=count)
    data[int(at * (count - 1))] = 1000.0
    middle = float(t[count // 2])
    edges = stretches(t, [(middle, middle + 0.01)], points)
    assert edges[0] == 0
    assert edges[-1] == count
    assert np.all(np.diff(edges) > 0)
    assert count // 2 in edges  # no stretch reaches over the step
    x, y = reduced_times(t, edges), reduced(data, edges)
    assert len(x) == len(y)
    assert np.all(np.diff(x) > 0)
    assert y.max() == 1000.0
    assert y.min() == data.min()


def test_a_short_signal_stays_as_it_is_and_a_gap_a_gap() -> None:
    t, data = np.arange(50.0), np.arange(50.0)
    edges = stretches(t, [], 100)
    assert reduced_times(t, edges) == pytest.approx(t)
    assert reduced(data, edges) == pytest.approx(data)
    data[10:30] = np.nan
    coarse = reduced(data, stretches(t, [], 20))
    assert np.isnan(coarse).any()
    assert np.nanmax(coarse) == 49.0


def test_a_ramp_stays_a_ramp_up_to_its_ends() -> None:
    t = np.arange(2000) * 0.002
    v = np.clip(t - 1, 0, 2)
    x = np.cumsum(v) * 0.002
    averaged = mean_velocity(t, x, 200, breaks=[500, 1500])
    assert np.abs(averaged - v).max() < 0.015
    assert np.abs(moving_average(v, 201, breaks=[500, 1500]) - v).max() < 0.015
