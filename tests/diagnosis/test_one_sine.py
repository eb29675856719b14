"""A lone axis that goes to and fro by one steady sine: what can't be told there is not named."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.diagnosis.axis_rig import Rig, axis_model
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.residual_noise import by_waves
from hilbench.diagnosis.smooth_motion import evenly_with, frequency_of_sine, harmonics
from hilbench.plant.effects import find_effect

#: What such a motion tells, and what of it is there in the rig beside a model of 80 % of its inertia.
THERE = {"coulomb_friction": 0.03, "inertia_mismatch": 0.25}
TOLD = {*THERE, "viscous_friction", "torque_offset"}


@cache
def on_a_sine(swing_Hz: float, swing_rad_s: float) -> list[Diagnosis]:
    recordings = Rig(swing=(swing_Hz, swing_rad_s)).recordings(2, seed=1)
    return [diagnose(recording, axis_model(1.6e-4), "blind") for recording in recordings]


@pytest.mark.parametrize(
    ("swing_Hz", "swing_rad_s"), [(3.0, 40.0), *slow((7.0, 10.0), (7.0, 30.0), (5.0, 20.0), (4.0, 60.0), (2.0, 30.0))]
)
def test_on_one_steady_sine_friction_offset_and_inertia_alone_are_named(swing_Hz: float, swing_rad_s: float) -> None:
    for found in on_a_sine(swing_Hz, swing_rad_s):
        assert {item.effect for item in found.effects} == TOLD
        for item in found.effects:
            strength = find_effect(item.effect).strength[0]
            low, high = item.parameters[strength].ci95
            assert not low <= find_effect(item.effect).parameter(strength).neutral <= high
            if item.effect == "inertia_mismatch":
                assert low < THERE[item.effect] < high


def test_what_one_steady_sine_can_not_tell_is_said() -> None:
    (found, _) = on_a_sine(3.0, 40.0)
    unseen = {item.effect: item for item in found.unobservable}
    assert {"load_dependent_friction", "friction_asymmetry", "unbalance", "backlash"} <= unseen.keys()
    assert unseen["friction_asymmetry"].experiment.endswith("to many speeds")
    tied = {name for item in found.effects for name in item.tied_with}
    assert not unseen.keys() & (tied | TOLD)
    assert "torque_delay" in tied | unseen.keys()


@pytest.mark.slow
def test_of_many_speeds_all_is_told() -> None:
    (recording,) = Rig().recordings(1, seed=1)
    found = diagnose(recording, axis_model(1.6e-4), "blind")
    assert not {"load_dependent_friction", "friction_asymmetry"} & {item.effect for item in found.unobservable}


@pytest.mark.parametrize("frequency_Hz", [0.37, 2.0, 7.13])
def test_a_sine_is_known_by_its_frequency(frequency_Hz: float) -> None:
    t_s = 0.004 * np.arange(2500)
    speed = 8.0 * np.sin(2.0 * np.pi * frequency_Hz * t_s + 0.4)
    found = frequency_of_sine(speed, 0.004)
    assert found == pytest.approx(frequency_Hz, abs=0.002)
    assert frequency_of_sine(speed + 2.0, 0.004) is None
    assert frequency_of_sine(speed + np.sin(9.0 * t_s), 0.004) is None
    assert frequency_of_sine(speed * (1.0 + 0.05 * t_s), 0.004) is None
    assert frequency_of_sine(np.arcsin(speed / 8.0), 0.004) is None  # a triangle
    assert frequency_of_sine(np.zeros(2500), 0.004) is None
    assert frequency_of_sine(np.full(2500, 6.3), 0.004) is None


def test_what_goes_evenly_with_the_position_is_the_size_of_the_speed() -> None:
    turned = 2.0 * np.pi * 3.0 * 0.001 * np.arange(2000)
    size = np.abs(np.cos(turned))
    even = evenly_with(0.2 + 0.7 * np.sin(turned))
    theta, *_ = np.linalg.lstsq(even.T, size, rcond=None)
    assert np.std(size - theta @ even) < 0.05 * np.std(size)
    changes_sign = np.sign(np.cos(turned))
    theta, *_ = np.linalg.lstsq(even.T, changes_sign, rcond=None)
    assert np.std(changes_sign - theta @ even) > 0.99 * np.std(changes_sign)


def test_intervals_of_what_repeats_itself_hold() -> None:
    rng = np.random.default_rng(7)
    waves = harmonics(2.0, 13.0, 0.005 * np.arange(1000))
    assert len(waves) == 13
    columns = rng.standard_normal((3, 13)) @ waves
    held = []
    for _ in range(1500):
        shapes = 0.7 * rng.standard_normal((2, 13)) @ waves
        scale = np.linalg.norm(waves, axis=1)
        error = (rng.standard_normal(13) / scale) @ waves * 4.0 + 0.02 * rng.standard_normal(2) @ shapes
        theta, *_ = np.linalg.lstsq(columns.T, error, rcond=None)
        known = by_waves(columns, error - theta @ columns, 0.02 * shapes, waves)
        held.append(np.abs(theta) < known.deviations * known.quantiles(0.95))
    assert 0.93 < np.mean(held) < 0.985  # what the shapes leave is noise as well, so they are a little wide
