"""Futures of a web line: what they are drawn from, and how near they come to the twin's own simulation."""

from __future__ import annotations

from dataclasses import replace
from math import erf, sqrt
from pathlib import Path

import numpy as np
import pytest

from hilbench.bench.prediction.web_line import LineLook
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import offline
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.futures import normal_draws
from hilbench.prediction.web_line import futures as line_futures
from hilbench.prediction.web_line.futures import LineCourses, LineFutures, LinePresent
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"


def futures_of(*changes: str, config: str = "web_section_step.yaml", count: int = 16) -> LineFutures:
    loaded = load_with_overrides(CONFIGS / config, changes=changes).config
    return LineLook(loaded, PredictionConfig(horizon_s=2.0, futures=count)).futures


def at_work(speed_m_s: float = 3.0, tension_N: float = 80.0, **changes: object) -> LinePresent:
    """The demonstrator's line in its steady state, its torques those that the tensions ask for."""
    speeds = np.full(2, speed_m_s)
    present = LinePresent(
        now_s=10.0,
        speeds_m_s=speeds,
        speeds_sd_m_s=np.zeros(2),
        torques_Nm=np.array([0.0, (tension_N - 70.0) * 0.2 / 5.0]),
        commands_m_s=speeds,
        commands_before_m_s=speeds,
        tensions_N=np.array([tension_N]),
        set_points_N=np.array([tension_N]),
        modulus_Pa=8.7e9,
        modulus_sd_Pa=0.0,
        upstream_strain=tension_N / (8.7e9 * 0.5 * 65e-6),
        downstream_tension_N=70.0,
        line_speed_m_s=speed_m_s,
        line_speed_before_m_s=speed_m_s,
    )
    return replace(present, **changes)  # type: ignore[arg-type]


def steady(futures: LineFutures, speed_m_s: float = 3.0, tension_N: float = 80.0) -> LineCourses:
    steps = futures.steps
    return LineCourses(np.full(steps, speed_m_s), np.full((steps, 1), tension_N), np.ones((steps, 1)))


def test_a_line_in_its_steady_state_stays_there() -> None:
    futures = futures_of()
    outlook = futures.look(at_work(), steady(futures), futures.no_offsets(), 1)
    assert outlook.rows[:, :, 0] == pytest.approx(80.0, abs=0.01)
    assert outlook.rows[:, :, outlook.place("tau2_Nm")] == pytest.approx(0.4, abs=0.001)
    assert outlook.rows[:, :, outlook.place("tau_load_Nm")] == pytest.approx(-0.4, abs=0.001)
    assert not list(outlook.crossings())


def test_an_estimate_that_is_not_sure_spreads_the_tension_by_as_much() -> None:
    futures = futures_of(count=256)
    outlook = futures.look(at_work(modulus_sd_Pa=0.02 * 8.7e9), steady(futures), futures.no_offsets(), 1)
    low, median, high = (each[-1] for each in outlook.band(0, 0.9))
    assert median == pytest.approx(80.0, abs=0.1)
    assert (high - low) / 2 == pytest.approx(1.645 * 0.02 * 80.0, rel=0.05)


def test_the_same_look_has_the_same_outlook_and_another_seed_another_one() -> None:
    futures = futures_of()
    present = at_work(modulus_sd_Pa=1e8, speeds_sd_m_s=np.full(2, 1e-4))
    one, same, other = (
        futures.look(present, steady(futures), futures.no_offsets(), *key) for key in ((1, 5), (1, 5), (2, 5))
    )
    assert np.array_equal(one.rows, same.rows)
    assert np.array_equal(one.probability, same.probability)
    assert not np.array_equal(one.rows, other.rows)


def test_a_step_that_is_planned_is_seen_to_cross_the_limit_when_it_will() -> None:
    futures = futures_of("safety.limits.tension_N.warning=90.0")
    courses = steady(futures)
    courses.modulus_factor[futures.times_s(10.0) >= 11.0] = 1.207
    outlook = futures.look(at_work(), courses, futures.no_offsets(), 1)
    (crossing,) = outlook.crossings()
    assert (crossing.watched.signal, crossing.level, crossing.probability) == ("F_true_N", "warning", 1.0)
    assert crossing.expected_s == pytest.approx(11.0, abs=0.01)
    assert outlook.largest[:, 0] == pytest.approx(80.0 * 1.207, abs=0.5)


def test_half_of_the_futures_cross_a_limit_at_the_median() -> None:
    futures = futures_of("safety.limits.tension_N.warning=96.56", count=256)
    courses = steady(futures)
    courses.modulus_factor[200:] = 1.207
    outlook = futures.look(at_work(modulus_sd_Pa=0.01 * 8.7e9), courses, futures.no_offsets(), 1)
    assert outlook.probability[0, 0] == pytest.approx(0.5, abs=0.02)
    assert outlook.probability[0, 1] == 0.0


def test_noise_of_the_measurement_crosses_a_limit_as_often_as_it_is_asked() -> None:
    """400 cycles of white noise about 0.4 N·m, 3 standard deviations below the limit."""
    futures = futures_of("safety.limits.torque_Nm.warning=0.55")
    offsets, place = futures.no_offsets(), 2
    offsets.noise[place] = 0.05
    outlook = futures.look(at_work(), steady(futures), offsets, 1)
    below = 0.5 * (1.0 + erf(3.0 / sqrt(2.0)))
    assert outlook.probability[place, 0] == pytest.approx(1.0 - below**1000, abs=0.03)


def test_with_feed_forward_a_set_point_goes_its_way_on_three_equal_poles() -> None:
    rise_s = 0.4
    changes = [f"controllers.tension_control.{each}" for each in ("feed_forward=twin", f"set_point_rise_s={rise_s}")]
    futures, plain = futures_of(*changes), futures_of()
    courses = steady(futures)
    courses.set_points_N[futures.times_s(10.0) >= 10.5] = 90.0
    outlook = futures.look(at_work(), courses, futures.no_offsets(), 1)
    since_s = np.maximum(outlook.times_s - 10.5, 0.0) * 7.5 / rise_s
    wanted_N = 90.0 - 10.0 * (1.0 + since_s + 0.5 * since_s**2) * np.exp(-since_s)
    found_N = np.median(outlook.rows[:, :, 0], axis=1)
    without_N = np.median(plain.look(at_work(), courses, plain.no_offsets(), 1).rows[:, :, 0], axis=1)
    assert np.max(np.abs(found_N - wanted_N)) < 0.5
    assert np.max(np.abs(without_N - wanted_N)) > 1.0


def test_with_feed_forward_a_ramp_moves_the_tension_by_much_less() -> None:
    """A roller that has its torque in time does not lag behind the others."""
    unequal = "machine.rollers.inertia_kg_m2=[1.167,1.5]"
    ahead, plain = futures_of(unequal, "controllers.tension_control.feed_forward=twin"), futures_of(unequal)
    courses = replace(steady(ahead), line_speed_m_s=3.0 + np.clip(ahead.times_s(10.0) - 10.5, 0.0, 1.0))
    off_N = [np.ptp(each.look(at_work(), courses, each.no_offsets(), 1).rows[:, :, 0]) for each in (ahead, plain)]
    assert off_N[1] > 5.0
    assert off_N[0] < 0.5 * off_N[1]


def test_the_coarse_step_changes_a_ramp_by_less_than_two_hundredths_of_what_is_steered() -> None:
    """Against the twin's simulation at the drives' own sample time, on the same commands."""
    loaded = load_with_overrides(
        CONFIGS / "web_section_step.yaml", changes=["controllers.tension_control.swing_damping_ratio=0"]
    )
    model = loaded.config.web_line
    futures = LineLook(loaded.config, PredictionConfig(horizon_s=2.0, futures=16)).futures
    times_s = futures.times_s(10.0)
    courses = replace(steady(futures), line_speed_m_s=3.0 + 0.75 * np.minimum(times_s - 10.0, 1.0))
    outlook = futures.look(at_work(), courses, futures.no_offsets(), 1)
    fine = np.minimum(np.arange(2000) * 1e-3, 1.0) * 0.75 + 3.0
    p = lay.pack(model)
    state = offline.start_state(p, model, 80.0 / model.stiffness_N(1))
    layout = lay.Layout.of(p)
    y = layout.y(state)
    y[2:4] = y[6:8] = 3.0
    motors = layout.motor_states(state)
    motors.mode, motors.reference = 2.0, 3.0 * 25.0
    motors[1].torque_Nm = motors[1].command_Nm = motors[1].integral_Nm = 0.4
    exact = offline.simulate(
        p, state, np.stack([fine, fine], axis=1), np.tile([model.upstream_strain, 70.0], (2000, 1)), 1e-3
    )
    at = np.round((outlook.times_s - 10.0) * 1e3).astype(int)
    at = at[at < 2000]
    for signal, column in (("tau1_Nm", exact.tau_Nm[:, 0]), ("v2_m_s", exact.v_m_s[:, 1])):
        found = np.median(outlook.rows[: len(at), :, outlook.place(signal)], axis=1)
        assert np.max(np.abs(found - column[at])) < 0.02 * max(np.ptp(column), 0.75), signal


def test_a_line_of_two_spans_has_a_step_that_its_lighter_spans_allow() -> None:
    stiff = futures_of(config="line_two_spans.yaml")
    assert stiff.step_s <= 0.007
    assert futures_of("machine.rollers.inertia_kg_m2=0.05").step_s < 0.003


def test_a_coarse_step_changes_little_of_what_comes_of_a_set_point_in_one_of_two_spans(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    courses = {}
    for longest_s in (0.001, None):
        if longest_s is not None:
            monkeypatch.setattr(line_futures, "_LONGEST_STEP_S", longest_s)
        futures = futures_of(config="line_two_spans.yaml")
        monkeypatch.undo()
        present, course = futures.at_rest()
        wanted_N = course.set_points_N + np.outer(futures.times_s(0.0) >= 0.5, [10.0, 0.0])
        outlook = futures.look(present, replace(course, set_points_N=wanted_N), futures.no_offsets(), 1)
        courses[longest_s] = outlook
    fine, coarse = courses.values()
    assert coarse.times_s[1] - coarse.times_s[0] != fine.times_s[1] - fine.times_s[0]
    for signal, most in (("F1_true_N", 0.3), ("F2_true_N", 0.3), ("tau1_Nm", 0.01), ("tau2_Nm", 0.01)):
        place = fine.place(signal)
        exact, found = (np.median(each.rows[:, :, place], axis=1) for each in (fine, coarse))
        off = found - np.interp(coarse.times_s, fine.times_s, exact)
        assert np.sqrt(np.mean(off**2)) < most, signal


@pytest.mark.parametrize("count", [16, 64, 100])
def test_few_draws_cover_the_whole_distribution(count: int) -> None:
    draws = normal_draws(count, 3, 7)
    assert draws.shape == (count, 3)
    assert np.mean(draws, axis=0) == pytest.approx(0.0, abs=1e-12)
    assert np.std(draws, axis=0) == pytest.approx(1.0, abs=0.06)
    assert not np.array_equal(draws[:, 0], draws[:, 1])
