"""A load motor makes the shaft behave like one that is not there; how far that is stable."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hilbench.plant.interface import Follower
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.emulation import EmulatedShaft
from hilbench.plant.servo_axis.offline import simulate
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters, ShaftParameters
from hilbench.plant.servo_axis.shaft import ServoRig
from hilbench.plant.servo_axis.stability import imitable_inertia_kg_m2, sampled_shaft, spectral_radius
from hilbench.plant.servo_axis.tracking_filter import TrackingFilter

from .models import axis, effect

CYCLE_S = 0.002
REAL = ShaftParameters(inertia_kg_m2=0.039, coulomb_friction_Nm=0.05, viscous_friction_Nm_s_per_rad=0.001)


def stand(model: ServoAxisParameters) -> ServoRigParameters:
    return ServoRigParameters.matching(model, REAL)


def emulate(model: ServoAxisParameters, commands: np.ndarray, lead_s: float | None = None, **given: Any) -> np.ndarray:
    """Position, speed and drive torque (n, 3) of the stand while it emulates the model."""
    real = stand(model)
    ports = [MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.TORQUE)]
    rig, emulated = ServoRig(real, ports), EmulatedShaft(model, real, CYCLE_S, **given)
    lead = emulation_delay_s(sampled_shaft(real, CYCLE_S)) if lead_s is None else lead_s
    emulated.reset([0.0])
    rows, waiting = [], 0.0
    for command in commands:
        rows.append((ports[0].position_rad, ports[0].velocity_rad_s, ports[0].torque_Nm))
        if len(rows) > 1:
            emulated.follow([ports[0].position_rad], CYCLE_S)
        ports[0].setpoint, ports[1].setpoint = command, waiting
        waiting = emulated.load_torques_Nm([1], [ports[0].velocity_rad_s], lead)[0]
        rig.step(CYCLE_S)
    return np.array(rows)


def test_flywheel_and_friction_that_are_not_there_are_felt_by_the_drive() -> None:
    model = axis(inertia_kg_m2=0.059, unbalance_Nm=0.3)
    t = np.arange(4000) * CYCLE_S
    commands = 10.0 * np.sin(2.0 * np.pi * 0.5 * t)
    there = simulate(lay.pack(model), lay.new_state(lay.pack(model)), commands, CYCLE_S)
    emulated = emulate(model, commands)
    alone = simulate(lay.pack(stand(model).axis), lay.new_state(lay.pack(stand(model).axis)), commands, CYCLE_S)
    late = slice(1000, None)
    difference = emulated[late, 2] - there.tau_Nm[late]
    # Dry friction is not as sharp as the true one for the moments around standstill.
    moving = np.abs(there.v_rad_s[late]) > 0.5
    assert np.sqrt(np.mean(difference[moving] ** 2)) < 0.01
    assert np.sqrt(np.mean((alone.tau_Nm[late] - there.tau_Nm[late])[moving] ** 2)) > 0.4


def apparent_inertia(torque: np.ndarray, speed: np.ndarray, phase: np.ndarray, frequency: float) -> float:
    """What torque and speed have in quadrature, whole periods of a sine."""
    at = np.exp(-1j * phase)
    return float(((torque @ at) / (speed @ at)).imag / (2.0 * np.pi * frequency))


@pytest.mark.parametrize("frequency", [0.25, 1.0, 2.0])
@pytest.mark.parametrize("inertia", [0.025, 0.06, 0.08])
def test_apparent_inertia_is_the_emulated_one(frequency: float, inertia: float) -> None:
    model = axis(inertia_kg_m2=inertia - 0.001, coulomb_friction_Nm=0.05, viscous_friction_Nm_s_per_rad=0.001)
    phase = 2.0 * np.pi * frequency * np.arange(5000) * CYCLE_S
    shown = emulate(model, 6.0 * np.sin(phase))[1000:]
    there = simulate(lay.pack(model), lay.new_state(lay.pack(model)), 6.0 * np.sin(phase), CYCLE_S)
    emulated = apparent_inertia(shown[:, 2], shown[:, 1], phase[1000:], frequency)
    true = apparent_inertia(there.tau_Nm[1000:], there.v_rad_s[1000:], phase[1000:], frequency)
    # What the filter makes of a sine: 0.9 % of the inertia that is not there at 1 Hz, as the square of the frequency.
    assert emulated == pytest.approx(true, abs=0.01 * frequency**2 * abs(inertia - 0.04) + 5e-6)
    assert true == pytest.approx(inertia, abs=4e-4)


def test_without_prediction_the_emulated_inertia_brakes_or_drives_the_shaft() -> None:
    model = axis(inertia_kg_m2=0.069, coulomb_friction_Nm=0.05, viscous_friction_Nm_s_per_rad=0.001)
    phase = 2.0 * np.pi * np.arange(4000) * CYCLE_S
    in_phase = {}
    for name, lead in (("predicted", None), ("not", 0.0)):
        shown = emulate(model, 8.0 * np.sin(phase), lead)[500:]
        in_phase[name] = np.mean(shown[:, 2] * shown[:, 1]) / np.mean(shown[:, 1] ** 2)
    there = simulate(lay.pack(model), lay.new_state(lay.pack(model)), 8.0 * np.sin(phase), CYCLE_S)
    true = np.mean(there.tau_Nm[500:] * there.v_rad_s[500:]) / np.mean(there.v_rad_s[500:] ** 2)
    assert in_phase["predicted"] == pytest.approx(true, abs=4e-4)
    assert abs(in_phase["not"] - true) > 3e-3


@pytest.mark.parametrize("side", [0, 1])
def test_inertia_can_be_emulated_up_to_the_computed_limits_and_not_beyond(side: int) -> None:
    real = stand(axis())
    shaft = sampled_shaft(real, CYCLE_S)
    limits = imitable_inertia_kg_m2(shaft)
    assert limits[0] < 0.75 * 0.04
    assert limits[1] > 2.0 * 0.04
    without = {"coulomb_friction_Nm": 0.05, "viscous_friction_Nm_s_per_rad": 0.001}
    swings = []
    for share in (0.97, 1.03):
        inertia = 0.04 + share * (limits[side] - 0.04)
        model = axis(inertia_kg_m2=inertia - 0.001, **without)
        shown = emulate(model, np.full(3000, 5.0))[:, 1] - 5.0
        swings.append(np.abs(shown[-300:]).max())
        assert (spectral_radius(shaft, inertia - 0.04) < 1.0) == (share < 1.0)
    assert swings[0] < 0.02
    assert swings[1] > 100 * swings[0]


def test_longer_filter_allows_more_inertia() -> None:
    shaft = sampled_shaft(stand(axis()), CYCLE_S)
    largest = [imitable_inertia_kg_m2(shaft, cycles)[1] for cycles in (1.0, 2.5, 5.0)]
    assert largest == sorted(largest)


def test_emulated_dry_friction_holds_the_shaft_at_standstill_without_chattering() -> None:
    model = axis(inertia_kg_m2=0.06, coulomb_friction_Nm=0.6)
    shown = emulate(model, np.concatenate([np.full(1000, 10.0), np.zeros(2000)]))
    assert shown[900, 2] == pytest.approx(0.6 + 0.004 * 10.0, abs=5e-3)
    assert np.abs(shown[-500:, 1]).max() < 1e-3


def test_inertia_steps_while_the_shaft_turns() -> None:
    model, real = axis(inertia_kg_m2=0.059), stand(axis())
    emulated = EmulatedShaft(model, real, CYCLE_S)
    assert isinstance(emulated, Follower)
    emulated.reset([0.0])
    for k in range(1, 400):
        t = k * CYCLE_S
        emulated.follow([2.0 * t + 5.0 * t * t], CYCLE_S)
    assert emulated.outputs()["a1_rad_s2"] == pytest.approx(10.0, abs=1e-4)
    before = emulated.load_torques_Nm([1], [10.0], 0.004)[0]
    emulated.set_parameter("inertia_kg_m2", 1.25 * 0.06)
    after = emulated.load_torques_Nm([1], [10.0], 0.004)[0]
    assert emulated.parameter("inertia_kg_m2") == 1.25 * 0.06
    assert after - before == pytest.approx(-0.015 * 10.0, rel=1e-4)
    state = emulated.get_state()
    emulated.follow([0.0], CYCLE_S)
    emulated.set_state(state)
    assert emulated.load_torques_Nm([1], [10.0], 0.004)[0] == after


def test_effects_of_the_drive_cannot_be_emulated_those_of_the_shaft_can() -> None:
    emulated = EmulatedShaft(axis(effect("torque_offset", 0.5)), stand(axis()), CYCLE_S)
    with pytest.raises(ValueError, match="torque_scale belongs in 'hardware:'"):
        emulated.set_effect("torque_scale", 1, relative_change=0.1)
    with pytest.raises(ValueError, match="expected axis 1"):
        emulated.load_torques_Nm([2], [0.0], 0.004)
    emulated.reset([0.0])
    plain = emulated.load_torques_Nm([1], [5.0], 0.004)[0]
    emulated.set_effect("viscous_friction", 1, **effect("viscous_friction", 0.01)["parameters"])
    assert emulated.load_torques_Nm([1], [5.0], 0.004)[0] == pytest.approx(plain - 0.05)
    emulated.clear_effect("viscous_friction", 1)
    assert emulated.load_torques_Nm([1], [5.0], 0.004)[0] == plain


def test_a_position_that_no_motor_can_have_brought_about_does_not_throw_the_shaft() -> None:
    model, real = axis(inertia_kg_m2=0.059), stand(axis())
    emulated = EmulatedShaft(model, real, CYCLE_S)
    emulated.reset([0.0])
    torques = []
    for k in range(1, 200):
        emulated.follow([20.0 * k * CYCLE_S + (0.1 if k == 150 else 0.0)], CYCLE_S)
        torques += emulated.load_torques_Nm([1], [20.0], 0.004)
    most_rad_s2 = (9.0 + 20.0) / 0.04
    assert max(map(abs, torques)) <= (0.06 - 0.04) * most_rad_s2 + 1.0


def test_filter_follows_constant_jerk_without_lag() -> None:
    motion = TrackingFilter(0.005)
    for k in range(300):
        t = k * CYCLE_S
        motion.update(1.0 + 2.0 * t - 3.0 * t**2 + 40.0 * t**3, CYCLE_S)
    t = 299 * CYCLE_S
    expected = [1.0 + 2.0 * t - 3.0 * t**2 + 40.0 * t**3, 2.0 - 6.0 * t + 120.0 * t**2, -6.0 + 240.0 * t, 240.0]
    assert motion.motion == pytest.approx(expected, rel=1e-6)
