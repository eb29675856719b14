"""Futures of a servo axis: what they are drawn from, and how near they come to its equations integrated otherwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hilbench.bench.prediction.create import look_of
from hilbench.bench.prediction.servo_axis import ShaftLook
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.servo_axis.futures import ShaftCourses, ShaftFutures, ShaftPresent
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "servo_axis.yaml"
Array = NDArray[np.float64]

# The shipped axis (SI, at the motor), and its stand.
J, DRY, VISCOUS = 0.048, 0.2, 0.004
KP, KI, LAG_S, SAMPLE_S, CYCLE_S = 1.5, 30.0, 0.001, 0.001, 0.002


@cache
def futures_of(*changes: str, count: int = 16) -> ShaftFutures:
    config = load_with_overrides(CONFIG, changes=changes).config
    look = look_of(config, PredictionConfig(horizon_s=2.0, futures=count))
    assert isinstance(look, ShaftLook)
    return look.futures


def at_work(speed_rad_s: float = 20.0) -> ShaftPresent:
    """The shaft in its steady state, its torque that of its friction."""
    return ShaftPresent(
        now_s=10.0,
        position_rad=0.0,
        speed_rad_s=speed_rad_s,
        speed_sd_rad_s=0.0,
        torque_Nm=DRY * np.sign(speed_rad_s) + VISCOUS * speed_rad_s,
        command_rad_s=speed_rad_s,
        error_rad_s=0.0,
        inertia_kg_m2=J,
        inertia_sd_kg_m2=0.0,
        dry_friction_Nm=DRY,
        dry_friction_sd_Nm=0.0,
        viscous_friction_Nm_s_per_rad=VISCOUS,
        viscous_friction_sd_Nm_s_per_rad=0.0,
    )


def steady(speed_rad_s: float = 20.0) -> Callable[[Array], ShaftCourses]:
    def at(times_s: Array) -> ShaftCourses:
        count = len(times_s)
        return ShaftCourses(np.full(count, speed_rad_s), np.ones(count), np.zeros(count))

    return at


def swing(times_s: Array) -> Array:
    """From 20 rad/s to 32 and back, then through zero to -8."""
    since_s = np.maximum(times_s - 10.0, 0.0)
    return np.where(
        since_s < 1.0,
        20.0 + 6.0 * (1.0 - np.cos(2.0 * np.pi * since_s)),
        np.maximum(20.0 - 40.0 * (since_s - 1.0), -8.0),
    )


def integrated(speed_of: Callable[[Array], Array], present: ShaftPresent, until_s: float) -> tuple[Array, Array, Array]:
    """Times, torque and speed by small steps of the equations as they are written: dry friction and PI loop, held
    between the samples of the drive; what is asked for acts a cycle later."""
    h = 2e-5
    count, per_sample = round(until_s / h), round(SAMPLE_S / h)
    asked = speed_of(present.now_s + np.arange(round(until_s / CYCLE_S)) * CYCLE_S)
    v, torque, integral = present.speed_rad_s, present.torque_Nm, present.torque_Nm
    command = torque
    rows = np.zeros((count, 3))
    for n in range(count):
        if n % per_sample == 0:
            cycle = int(n * h / CYCLE_S + 1e-9)
            error = (asked[cycle - 1] if cycle else present.command_rad_s) - v
            integral += KI * error * SAMPLE_S
            command = KP * error + integral
        torque += (command - torque) * h / LAG_S
        net = torque - VISCOUS * v
        sticks = v == 0.0 and abs(net) <= DRY
        a = 0.0 if sticks else (net - DRY * np.sign(v or net)) / J
        after = v + a * h
        v = 0.0 if v * after < 0.0 else after
        rows[n] = (n + 1) * h, torque, v
    return rows[:, 0], rows[:, 1], rows[:, 2]


def test_a_shaft_in_its_steady_state_stays_there() -> None:
    futures = futures_of()
    outlook = futures.look(at_work(), steady(), futures.no_offsets(), 1)
    assert outlook.rows[:, :, outlook.place("v1_rad_s")] == pytest.approx(20.0, abs=1e-6)
    assert outlook.rows[:, :, outlook.place("tau1_Nm")] == pytest.approx(DRY + VISCOUS * 20.0, abs=1e-6)
    # The stand has 0.05 N·m of dry friction itself; the load motor brings the rest.
    assert outlook.rows[:, :, outlook.place("tau_load_Nm")] == pytest.approx(-(DRY - 0.05 + VISCOUS * 20.0), abs=1e-6)
    assert not list(outlook.crossings())


def test_a_shaft_that_stands_under_its_friction_stays_there() -> None:
    futures = futures_of()
    present = replace(at_work(0.0), speed_rad_s=0.001, speed_sd_rad_s=0.001, torque_Nm=0.1)
    outlook = futures.look(present, steady(0.0), futures.no_offsets(), 1)
    assert np.max(np.abs(outlook.rows[:, :, outlook.place("v1_rad_s")])) == 0.0


def test_a_swing_through_zero_is_that_of_the_equations_as_they_are_written() -> None:
    futures, present = futures_of(), at_work()
    outlook = futures.look(
        present, lambda times_s: replace(steady()(times_s), speed_rad_s=swing(times_s)), futures.no_offsets(), 1
    )
    times_s, torque, speed = integrated(swing, present, 1.95)
    at = outlook.times_s - 10.0 < 1.9
    for signal, came, largest in (("tau1_Nm", torque, 0.06), ("v1_rad_s", speed, 0.15)):
        found = np.median(outlook.rows[:, :, outlook.place(signal)], axis=1)[at]
        off = found - np.interp(outlook.times_s[at] - 10.0, times_s, came)
        assert np.ptp(came) > 3.5
        assert np.max(np.abs(off)) < largest, signal
        assert np.sqrt(np.mean(off**2)) < 0.4 * largest, signal


def test_an_inertia_that_is_not_sure_spreads_the_torque_of_a_ramp_by_as_much() -> None:
    futures, rate = futures_of(count=256), 30.0
    present = replace(at_work(), inertia_sd_kg_m2=0.05 * J)
    outlook = futures.look(
        present,
        lambda times_s: replace(steady()(times_s), speed_rad_s=20.0 + rate * np.maximum(times_s - 10.0, 0.0)),
        futures.no_offsets(),
        1,
    )
    low, median, high = (each[19] for each in outlook.band(outlook.place("tau1_Nm"), 0.9))
    assert median == pytest.approx(J * rate + DRY + VISCOUS * 50.0, rel=0.01)
    assert (high - low) / 2 == pytest.approx(1.645 * 0.05 * J * rate, rel=0.05)


def test_a_friction_that_is_not_sure_spreads_the_torque_of_an_even_speed() -> None:
    futures = futures_of(count=256)
    outlook = futures.look(replace(at_work(), dry_friction_sd_Nm=0.02), steady(), futures.no_offsets(), 1)
    low, median, high = (each[-1] for each in outlook.band(outlook.place("tau1_Nm"), 0.9))
    assert median == pytest.approx(DRY + VISCOUS * 20.0, abs=0.001)
    assert (high - low) / 2 == pytest.approx(1.645 * 0.02, rel=0.05)


def test_a_viscous_friction_that_is_not_sure_spreads_it_in_proportion_to_the_speed() -> None:
    futures = futures_of(count=256)
    present = replace(at_work(), viscous_friction_Nm_s_per_rad=1.5 * VISCOUS, viscous_friction_sd_Nm_s_per_rad=0.001)
    outlook = futures.look(present, steady(), futures.no_offsets(), 1)
    low, median, high = (each[-1] for each in outlook.band(outlook.place("tau1_Nm"), 0.9))
    assert median == pytest.approx(DRY + 1.5 * VISCOUS * 20.0, abs=0.001)
    assert (high - low) / 2 == pytest.approx(1.645 * 0.001 * 20.0, rel=0.05)


def test_a_band_holds_what_will_be_measured_with_its_noise() -> None:
    futures = futures_of(count=256)
    offsets = replace(futures.no_offsets(), noise=np.array([0.03, 0.0, 0.0]))
    outlook = futures.look(replace(at_work(), dry_friction_sd_Nm=0.04), steady(), offsets, 1)
    low, median, high = (each[-1] for each in outlook.band(outlook.place("tau1_Nm"), 0.9))
    assert median == pytest.approx(DRY + VISCOUS * 20.0, abs=0.001)
    assert (high - low) / 2 == pytest.approx(1.645 * 0.05, rel=0.05)
    measured = outlook.rows[-1, :, 0] + 0.03 * np.random.default_rng(1).standard_normal((100, 256))
    assert np.mean((low <= measured) & (measured <= high)) == pytest.approx(0.9, abs=0.015)


def test_a_step_of_inertia_that_is_planned_is_in_the_ramp_behind_it() -> None:
    futures = futures_of("safety.limits.torque_Nm.warning=2.4")

    def asked(factor: float) -> Callable[[Array], ShaftCourses]:
        return lambda times_s: ShaftCourses(
            20.0 + 30.0 * np.clip(times_s - 11.0, 0.0, 0.6),
            np.where(times_s < 10.5, 1.0, factor),
            np.zeros(len(times_s)),
        )

    assert not list(futures.look(at_work(), asked(1.0), futures.no_offsets(), 1).crossings())
    (crossing,) = futures.look(at_work(), asked(1.25), futures.no_offsets(), 1).crossings()
    assert (crossing.watched.signal, crossing.level, crossing.probability) == ("tau1_Nm", "warning", 1.0)
    assert 11.05 < crossing.expected_s < 11.3


def test_a_lighter_shaft_has_shorter_steps() -> None:
    """The drive's loop on a tenth of the inertia would not be stable at the step of the whole."""
    futures = futures_of()
    present = replace(at_work(), inertia_kg_m2=0.1 * J)
    speed = futures.look(present, steady(), futures.no_offsets(), 1).rows[:, :, 2]
    assert speed == pytest.approx(20.0, abs=1e-6)


def test_the_same_look_has_the_same_outlook_and_another_seed_another_one() -> None:
    futures = futures_of()
    present = replace(at_work(), inertia_sd_kg_m2=0.02 * J, speed_sd_rad_s=0.01)
    one, same, other = (
        futures.look(present, steady(30.0), futures.no_offsets(), *key) for key in ((1, 5), (1, 5), (2, 5))
    )
    assert np.array_equal(one.rows, same.rows)
    assert np.array_equal(one.probability, same.probability)
    assert not np.array_equal(one.rows, other.rows)
