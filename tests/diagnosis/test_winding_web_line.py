"""The grey-box model of a winding line against lines that scipy simulates."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import StateSpace, lsim
from tests.tiers import slow
from tools.winding_line import LineRecording, fit_line, held_lag, held_lags, lag, vaf_percent

Array = NDArray[np.float64]
PERIOD_S, ROWS, FINE = 0.1, 2400, 20
TRUE = {
    "span_lag_s": 0.5,
    "current_lag_s": 0.15,
    "draw_friction": 0.3,
    "unwinder_torque_1": -1.4,
    "pacer_inertia": 0.25,
    "span_2_lag_s": 0.2,
    "unwinder_torque_2": -0.45,
    "rewinder_torque_2": 0.8,
}
REEL_INERTIA = 0.7


def first_order(values: Array, lag_s: float, held: bool = False) -> Array:
    """By scipy on a fine grid, of what goes straight between samples or is held; (n,)."""
    fine_s = PERIOD_S / FINE
    t = np.arange(len(values) * FINE) * fine_s
    drive = np.repeat(values, FINE) if held else np.interp(t, np.arange(len(values)) * PERIOD_S, values)
    system = StateSpace([[-1.0 / lag_s]], [[1.0 / lag_s]], [[1.0]], [[0.0]])
    _, out, _ = lsim(system, drive, t, X0=[values[0]], interp=not held)
    return np.asarray(out)[::FINE]


def steps(generator: np.random.Generator, every: int) -> Array:
    return np.repeat(generator.normal(size=ROWS // every + 1), every)[:ROWS]


def simulated(seed: int, noise: float) -> LineRecording:
    generator = np.random.default_rng(seed)
    u1, u2, u3 = (first_order(steps(generator, every), 0.3) for every in (25, 17, 31))
    i1, i3 = steps(generator, 40), steps(generator, 23)

    def accelerated(u: Array) -> Array:
        return u - first_order(u, TRUE["span_lag_s"])

    behind = first_order(i1, TRUE["current_lag_s"], held=True)
    tension_1 = (
        TRUE["draw_friction"] * first_order(u2 - u3, TRUE["span_lag_s"])
        + TRUE["unwinder_torque_1"] * first_order(behind, TRUE["span_lag_s"])
        + REEL_INERTIA * accelerated(u1 + u3)
        + TRUE["pacer_inertia"] * accelerated(u2)
    )
    tension_2 = TRUE["unwinder_torque_2"] * first_order(i1, TRUE["span_2_lag_s"], held=True) + TRUE[
        "rewinder_torque_2"
    ] * first_order(i3, TRUE["span_2_lag_s"], held=True)
    tensions = [tension + noise * generator.normal(size=ROWS) for tension in (tension_1, tension_2)]
    return LineRecording(PERIOD_S, u1, u2, u3, i1, i3, *tensions)


def halves() -> tuple[slice, slice]:
    return slice(10, ROWS // 2), slice(ROWS // 2, None)


@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
def test_gains_and_lags_of_a_simulated_line_are_found(seed: int) -> None:
    fit = fit_line(simulated(seed, 0.05), *halves())
    found = {p.name: p for p in fit.parameters}
    assert len(found) == 12
    for name in TRUE:
        assert found[name].value == pytest.approx(TRUE[name], rel=0.1), name
    # The reels' inertia is two parameters that make up for each other; what they do together is known.
    assert min(fit.vaf_percent) > 98.0


def test_the_half_that_is_run_freely_is_not_looked_at() -> None:
    line = simulated(4, 0.05)
    train, test = halves()
    spoilt = np.concatenate([line.tension_1[: ROWS // 2], np.zeros(ROWS - ROWS // 2)])
    changed = LineRecording(**{**line.__dict__, "tension_1": spoilt})
    np.testing.assert_array_equal(fit_line(line, train, test).tensions, fit_line(changed, train, test).tensions)


def test_what_the_data_do_not_excite_is_not_told() -> None:
    line = simulated(5, 0.05)
    still = LineRecording(**{**line.__dict__, "rewinder_current": np.zeros(ROWS)})
    found = {p.name: p for p in fit_line(still, *halves()).parameters}
    assert not found["rewinder_torque_2"].is_identified
    assert found["draw_friction"].is_identified


def test_lags_are_those_of_scipy() -> None:
    values = steps(np.random.default_rng(6), 7)[:300]
    np.testing.assert_allclose(lag(values, 0.35, PERIOD_S), first_order(values, 0.35), atol=2e-4)
    np.testing.assert_allclose(held_lag(values, 0.35, PERIOD_S), first_order(values, 0.35, held=True), atol=1e-9)
    at_once = held_lags(values, 0.35, 1e-3, PERIOD_S)
    np.testing.assert_allclose(at_once, held_lag(values, 0.35, PERIOD_S), atol=0.02)


def test_vaf_of_a_perfect_run_is_a_hundred_percent() -> None:
    values = np.sin(np.arange(50.0))
    assert vaf_percent(values, values) == 100.0
    assert vaf_percent(values, np.zeros(50)) == pytest.approx(0.0)
