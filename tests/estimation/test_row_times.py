"""Recordings stamped by another clock than that of the axes, and rows of another cycle than the twin's."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from tests.estimation.runs import CYCLE_S, NEW_PA, OLD_PA, STEP_S, Array, measured, stepped, time_to_1pct_s, tracked
from tests.plant.models import model
from tests.simulated_measurements import ENCODER_RAD, simulated_measurements

from hilbench.estimation.row_times import row_times
from hilbench.estimation.web_line.config import ChangepointConfig
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.offline import Track

TRUE = stepped(6.0)


def rows_of(data: Measurements, rows: Array) -> Measurements:
    return Measurements(**{each.name: getattr(data, each.name)[rows] for each in fields(Measurements)})


def positions(t_s: Array) -> Array:
    """Of two axes that ramp up within 1 s, then run at 3 m/s, with a swing."""
    x = 1.5 * np.minimum(t_s, 1.0) ** 2 + 3.0 * np.maximum(t_s - 1.0, 0.0) + 1e-4 * np.sin(20.0 * t_s)
    return np.column_stack([x, x])


@pytest.fixture(scope="module")
def in_step() -> tuple[Measurements, Track]:
    data = measured(TRUE, seed=5)
    return data, tracked(data, ChangepointConfig())


def drifting(t_s: Array) -> Array:
    return t_s * (1.0 + 200e-6)


def set_under_way(t_s: Array) -> Array:
    return t_s + np.where(t_s > 4.0, 0.05, 0.0)


def read_late(t_s: Array) -> Array:
    return np.sort(t_s + np.random.default_rng(1).exponential(0.0003, len(t_s)) + np.arange(len(t_s)) * 1e-12)


@pytest.mark.parametrize("stamped", [drifting, set_under_way, read_late])
def test_the_clock_that_stamps_a_recording_does_not_matter(
    stamped: object, in_step: tuple[Measurements, Track]
) -> None:
    data, expected = in_step
    assert callable(stamped)
    track = tracked(replace(data, t_s=stamped(data.t_s)), ChangepointConfig())
    assert np.array_equal(track.E_Pa, expected.E_Pa)
    assert np.array_equal(track.F_sim_N, expected.F_sim_N)


@pytest.mark.parametrize("lost", [slice(1000, 1025), slice(2000, 2003), slice(100, 110)])
def test_lost_rows_are_cycles_without_a_measurement(lost: slice, in_step: tuple[Measurements, Track]) -> None:
    data, expected = in_step
    kept = np.delete(np.arange(len(TRUE)), lost)
    track = tracked(rows_of(data, kept), ChangepointConfig())
    assert len(track.E_Pa) == len(kept)
    settled = slice(-500, None)
    assert track.E_Pa[settled] == pytest.approx(expected.E_Pa[settled], rel=2e-3)
    after = np.searchsorted(kept, lost.stop + 10)
    assert track.F_sim_N[after:] == pytest.approx(expected.F_sim_N[kept][after:], abs=0.1 + 0.003 * 97.0)
    assert time_to_1pct_s(rows_of(data, kept), track, TRUE[kept]) == pytest.approx(0.092, abs=0.02)


def at_times(t_s: Array, noise_Nm: float = 0.05) -> tuple[Measurements, Array]:
    """What axes that are asked at these times measure, and the E at them."""
    fine_s = np.arange(0.0, t_s[-1] + 0.01, 0.001)
    speed = 3.0 * np.minimum(fine_s, 1.0)
    modulus = np.where(fine_s >= STEP_S, NEW_PA, OLD_PA)
    truth = simulated_measurements(
        model(), np.column_stack([speed, speed]), modulus, cycle_s=0.001, torque_noise_Nm=0.0
    )
    rng = np.random.default_rng(7)
    counts = ENCODER_RAD / model().motor_rad_per_m(1)
    last = np.searchsorted(fine_s, t_s + 1e-9, side="right") - 1
    x_m = CubicSpline(fine_s, truth.x_m)(t_s)
    return (
        Measurements(
            t_s,
            truth.v_cmd_m_s[last],
            np.round(x_m / counts) * counts,
            np.interp(t_s, fine_s, truth.tau2_Nm) + noise_Nm * rng.standard_normal(len(t_s)),
            truth.strain_prev[last],
            truth.F_next_N[last],
        ),
        np.where(t_s >= STEP_S, NEW_PA, OLD_PA),
    )


def odd_times(seed: int, count: int = 3000) -> Array:
    return np.cumsum(0.002 * (1.0 + 0.3 * np.random.default_rng(seed).uniform(-1.0, 1.0, count)))


@pytest.mark.parametrize(
    "t_s",
    [np.arange(1800) * 0.0033, np.arange(2400) * 0.0025, np.arange(8000) * 0.00075, odd_times(3)],
    ids=["3.3 ms", "2.5 ms", "0.75 ms", "odd times"],
)
def test_rows_of_another_cycle_are_brought_to_the_twins(t_s: Array, in_step: tuple[Measurements, Track]) -> None:
    usual, expected = in_step
    data, true = at_times(t_s)
    track = tracked(data, ChangepointConfig())
    assert len(track.E_Pa) == len(t_s)
    found_s = time_to_1pct_s(data, track, true)
    assert found_s is not None
    assert found_s < 0.2
    settled = (t_s > STEP_S + 1.0) & (t_s < usual.t_s[-1])
    assert track.E_Pa[settled] == pytest.approx(NEW_PA, rel=2e-3)
    before = (t_s > 1.5) & (t_s < STEP_S - 0.01)
    for part in (before, settled):
        tension_N = np.interp(t_s[part], usual.t_s, expected.F_sim_N * TRUE / expected.E_Pa)
        assert float(np.sqrt(np.mean((track.F_sim_N[part] * true[part] / track.E_Pa[part] - tension_N) ** 2))) < 0.1


def test_a_splice_is_not_told_before_reality_has_it(in_step: tuple[Measurements, Track]) -> None:
    """Between two cycles of the twin E is held; it is no mean of what was and what comes."""
    t_s = np.arange(8000) * 0.00075
    data, _ = at_times(t_s)
    track = tracked(data, ChangepointConfig())
    assert np.all(np.abs(track.E_Pa[(t_s > 1.5) & (t_s < STEP_S)] / OLD_PA - 1.0) < 0.002)
    held = np.diff(track.E_Pa[t_s > 1.5]) == 0.0
    assert held.mean() > 0.2  # 0.75 ms in a cycle of 1 ms: one row in four is in the cycle of the one before


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    drift_ppm=st.floats(-300.0, 300.0),
    jump_s=st.floats(0.0, 0.2),
    jump_at=st.integers(100, 2800),
    jitter_s=st.floats(0.0, 0.0005),
    seed=st.integers(0, 1000),
)
def test_every_row_is_one_cycle_after_the_last_whatever_its_stamp(
    drift_ppm: float, jump_s: float, jump_at: int, jitter_s: float, seed: int
) -> None:
    t_s = np.arange(3000) * CYCLE_S
    stamps = t_s * (1.0 + 1e-6 * drift_ppm) + jitter_s * np.random.default_rng(seed).uniform(0.0, 1.0, len(t_s))
    stamps[jump_at:] += jump_s
    moving = t_s[jump_at] > 0.1 and jump_s > 0.0
    found = row_times(stamps, positions(t_s))
    assert found.even
    if moving or not jump_s:
        assert found.times_s / found.period_s == pytest.approx(np.arange(3000), abs=1e-6)
    assert found.period_s == pytest.approx(CYCLE_S * (1.0 + 1e-6 * drift_ppm), abs=3e-7)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), drift_ppm=st.floats(-300.0, 300.0), seed=st.integers(0, 1000))
def test_rows_that_are_missing_are_counted(data: st.DataObject, drift_ppm: float, seed: int) -> None:
    t_s = np.arange(3000) * CYCLE_S
    gap = data.draw(st.integers(1, 40))
    first = data.draw(st.integers(100, 2900))
    kept = np.delete(np.arange(3000), slice(first, first + gap))
    found = row_times(t_s[kept] * (1.0 + 1e-6 * drift_ppm), positions(t_s)[kept])
    assert found.even
    assert np.array_equal(found.periods, kept)


@settings(max_examples=40, deadline=None)
@given(spread=st.floats(0.05, 0.45), seed=st.integers(0, 1000))
def test_axes_that_are_asked_at_odd_times_have_moved_as_far_as_the_stamps_say(spread: float, seed: int) -> None:
    t_s = np.cumsum(CYCLE_S * (1.0 + spread * np.random.default_rng(seed).uniform(-1.0, 1.0, 3000)))
    found = row_times(t_s, positions(t_s))
    assert not found.even
    assert found.times_s == pytest.approx(t_s - t_s[0])
