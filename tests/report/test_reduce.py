"""Reduced signals keep what the eye would see."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.report.reduce import envelope, mean_velocity, moving_average, thinned


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
