"""Diagnosis of axes that mostly turn round: plays, presliding, arms; stand-ins that solve their own equations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.diagnosis.axis_rig import axis_model
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording

Array = NDArray[np.float64]
PERIOD_S = 0.001


def recording(x: Array, torque: Array, *, count: float = 1e-6, noise: float = 0.0, every: int = 1) -> Recording:
    rng = np.random.default_rng(0)
    t_s = np.arange(len(x)) * PERIOD_S
    measured = torque + noise * rng.standard_normal(len(x))
    channels = {"t_s": t_s, "x1_m": count * np.round(x / count), "tau1_Nm": measured}
    return Recording({name: values[::every] for name, values in channels.items()})


def names(found: Diagnosis) -> set[str]:
    return {item.effect for item in found.effects}


def value(found: Diagnosis, name: str) -> float:
    (item,) = (item for item in found.effects if item.effect == name)
    return next(iter(item.parameters.values())).value


def damper(presliding_travel: float, play: float, *, seconds: float = 16.0) -> tuple[Array, Array]:
    """Position and force of a band with friction, driven to and fro ever further, then by the same stroke.

    The band is two springs with a play between their ends, and slides when either pulls with 4000 N.
    """
    t = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    x = 0.025 * np.minimum(t / 5.0, 1.0) * np.sin(2.0 * np.pi * 0.5 * t)
    stiffness, band, force = 4000.0 / presliding_travel, 0.0, np.empty(len(t))
    for k, at in enumerate(x):
        band = min(max(band, at - 0.5 * play - presliding_travel), at + 0.5 * play + presliding_travel)
        apart = at - band
        force[k] = stiffness * (max(apart - 0.5 * play, 0.0) + min(apart + 0.5 * play, 0.0))
    return x, force + 300.0


@pytest.mark.parametrize(
    ("presliding_travel", "play", "every"),
    [(0.001, 0.003, 4), *slow((0.001, 0.003, 1), (0.0015, 0.005, 1), (0.0015, 0.005, 4))],
)
def test_a_play_behind_which_friction_holds_is_named_with_its_size(
    presliding_travel: float, play: float, every: int
) -> None:
    x, force = damper(presliding_travel, play)
    found = diagnose(recording(x, force, noise=20.0, every=every), axis_model(1e-3), "damper")
    assert names(found) == {"coulomb_friction", "backlash", "torque_offset"}
    assert value(found, "coulomb_friction") == pytest.approx(4000.0, rel=0.02)
    assert value(found, "backlash") == pytest.approx(play, rel=0.02)
    (presliding,) = (item for item in found.nuisance if item.effect == "presliding")
    low, high = presliding.parameters["way_m"].ci95
    assert low <= presliding_travel
    assert high >= presliding_travel
    assert found.gap.after < 0.05 * float(np.std(force))


def test_an_axis_that_goes_to_and_fro_for_a_minute_by_a_short_stroke_moves() -> None:
    x, force = damper(0.001, 0.003, seconds=60.0)
    measured_from(recording(x, force, noise=20.0), axis_model(1e-3), "damper")
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(x))
    with pytest.raises(UnusableInputError, match="nothing moves"):
        measured_from(recording(noise, force, noise=20.0), axis_model(1e-3), "damper")


def test_friction_that_turns_over_a_way_is_no_play() -> None:
    x, force = damper(0.002, 0.0)
    found = diagnose(recording(x, force, noise=20.0), axis_model(1e-3), "damper")
    assert names(found) == {"coulomb_friction", "torque_offset"}
    assert value(found, "coulomb_friction") == pytest.approx(4000.0, rel=0.02)
    assert [item.effect for item in found.nuisance] == ["presliding"]


def test_friction_that_turns_over_at_once_shows_no_presliding() -> None:
    x, _ = damper(0.001, 0.0)
    force = 4000.0 * np.tanh(np.gradient(x, PERIOD_S) / 1e-4)
    found = diagnose(recording(x, force, noise=20.0), axis_model(1e-3), "damper")
    assert names(found) == {"coulomb_friction"}
    assert found.nuisance == []


def test_an_axis_that_turns_round_quickly_is_looked_at_while_it_does() -> None:
    t = np.arange(10_000) * PERIOD_S
    x = 0.5 * np.sin(2.0 * np.pi * 2.0 * t)
    v = np.gradient(x, PERIOD_S)
    data = measured_from(recording(x, 0.2 * np.sign(v), noise=0.01), axis_model(1e-2), "quick")
    predictor = OnMeasuredMotion(axis_model(1e-2), data)
    assert np.mean(predictor.rows) > 0.95


def arm(size: float, seconds: float = 12.0) -> tuple[Array, Array, Array]:
    """Angle, speed and acceleration of an arm that swings, by `size` rad to either side, with two frequencies."""
    t = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    waves = [(0.7, 0.6, 0.0), (0.3, 1.1, 1.0)]
    x = size * sum(a * np.sin(2.0 * np.pi * f * t + p) for a, f, p in waves)
    v = np.gradient(np.asarray(x), PERIOD_S)
    return np.asarray(x), v, np.gradient(v, PERIOD_S)


def test_gravity_of_an_arm_is_named_with_its_size() -> None:
    x, v, a = arm(1.2)
    torque = 1e-2 * a + 0.12 * np.sign(v) + 1.1 * np.sin(x)
    found = diagnose(recording(x, torque, count=1e-4, noise=0.02), axis_model(1e-2), "arm")
    assert {"coulomb_friction", "unbalance"} <= names(found)
    assert value(found, "unbalance") == pytest.approx(1.1, rel=0.05)
    assert value(found, "coulomb_friction") == pytest.approx(0.12, rel=0.05)


def test_in_less_than_a_radian_a_spring_is_no_gravity_and_no_error_of_the_encoder() -> None:
    x, v, a = arm(0.25)
    torque = 1e-2 * a + 0.12 * np.sign(v) + 0.8 * x
    found = diagnose(recording(x, torque, count=1e-5, noise=0.02), axis_model(1e-2), "arm")
    assert names(found) == {"coulomb_friction"}
    assert found.verdict == "unknown"
    tied = {name for item in found.effects for name in item.tied_with}
    assert not tied & {"unbalance", "encoder_error"}


def test_a_load_that_swings_behind_its_arm_by_now_more_now_less_is_no_delay() -> None:
    x, v, a = arm(1.2)
    t = np.arange(len(x)) * PERIOD_S
    behind_s = 0.03 + 0.025 * np.sign(np.sin(2.0 * np.pi * t / 3.0))
    torque = 1e-2 * a + 0.12 * np.sign(v) + 1.1 * np.sin(np.interp(t - behind_s, t, x))
    found = diagnose(recording(x, torque, count=1e-4, noise=0.02), axis_model(1e-2), "arm")
    assert {"coulomb_friction", "unbalance"} <= names(found)
    assert "torque_delay" not in names(found)


def test_more_inertia_fed_forward_than_there_is_is_an_inertia_that_the_torque_lacks() -> None:
    x, v, a = arm(3.0)
    torque = -0.2e-2 * a + 0.2 * np.sign(v) + 0.05 * v
    found = diagnose(recording(x, torque, count=1e-4, noise=0.02), axis_model(1e-2), "axis")
    (lacking,) = (item for item in found.effects if item.effect in ("inertia_mismatch", "feed_forward"))
    assert {lacking.effect, *lacking.tied_with} >= {"inertia_mismatch", "feed_forward"}
    assert lacking.effect == "inertia_mismatch"


def test_a_loop_that_answers_a_ripple_late_is_no_delay_of_the_torque() -> None:
    t = np.arange(10_000) * PERIOD_S
    v = 60.0 * np.interp(t, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0], [0.0, 1.0, 0.0, -1.0, 0.0, 0.0])
    x = np.cumsum(v) * PERIOD_S
    late = 5.0 * v * 0.012  # a lag of 12 ms of the loop, which moves nothing but the answer to the ripple
    ripple = 1.5e-3 / np.sqrt(1.0 + (5.0 * v * 0.004) ** 2) * np.sin(5.0 * x - late)
    torque = 0.03 * np.sign(v) + 3e-4 * v - 4e-3 + ripple
    count = 2.0 * np.pi / 10_000
    found = diagnose(recording(x, torque, count=count, noise=1e-3, every=2), axis_model(1.66e-4), "axis")
    assert not names(found) & {"torque_delay", "encoder_error", "unbalance"}
    assert {"coulomb_friction", "viscous_friction", "torque_offset", "torque_ripple"} <= names(found)
