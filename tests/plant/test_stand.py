"""The simulated hardware: shafts, load motor, sensors, and how much can be emulated on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.parameters import EffectEntry, LoadMotorParameters
from hilbench.plant.sampled_shaft import (
    LinearLaw,
    SampledShaft,
    emulation_delay_s,
    largest_stable,
    spectral_radius_under,
)
from hilbench.plant.sensors import SensorNoise, SensorParameters
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, TestRig
from hilbench.plant.web_line.stability import largest_stiffness_Nm_per_rad, sampled_shaft, spectral_radius

from .models import model

CYCLE_S = 0.002
RAD_PER_M = 25.0
INERTIA = 1.167 / 25 + 0.001
NOISY = SensorParameters(torque_noise_Nm=0.05, velocity_noise_rad_s=0.0025, encoder_rad_per_count=2 * np.pi / 2**20)


def stand(**given: Any) -> tuple[TestRig, list[MotorPort]]:
    ports = [MotorPort() for _ in range(3)]
    seed = given.pop("seed", 0)
    motor = given.pop("load_motor", LoadMotorParameters())
    load_motors = [CoupledMotor(axis=2, motor=motor)]
    return TestRig(RigParameters.matching(model(), load_motors, **given), ports, seed), ports


def test_torques_of_axis_and_load_motor_add_on_the_second_shaft() -> None:
    bench, ports = stand(load_motor=LoadMotorParameters(inertia_kg_m2=0.01))
    for port, torque in zip(ports, (0.5, 1.0, -0.4), strict=True):
        port.mode, port.setpoint = MotorMode.TORQUE, torque
    bench.step(1.0)
    # The current loops' 1 ms delays each torque by as much.
    assert ports[0].velocity_rad_s == pytest.approx(0.5 / INERTIA * 0.999, rel=1e-4)
    assert ports[1].velocity_rad_s == pytest.approx(0.6 / INERTIA * 0.999, rel=1e-4)
    assert ports[2].velocity_rad_s == ports[1].velocity_rad_s
    assert ports[2].position_rad == ports[1].position_rad
    assert ports[2].torque_Nm == pytest.approx(-0.4)


def test_effect_of_an_axis_is_hidden_in_the_stand_at_start_and_at_run_time() -> None:
    hidden = EffectEntry(effect="coulomb_friction", axis=2, parameters={"force_N": 5.0})
    at_start, ports = stand(effects=[hidden])
    later, other = stand()
    later.set_effect("coulomb_friction", 2, force_N=5.0)
    for bench, three in ((at_start, ports), (later, other)):
        three[1].mode, three[1].setpoint = MotorMode.VELOCITY, 10.0
        bench.step(3.0)
        assert three[1].torque_Nm == pytest.approx(5.0 / RAD_PER_M, abs=1e-4)
    assert ports[1] == other[1]


def test_web_effects_are_refused() -> None:
    bench, _ = stand()
    with pytest.raises(ValueError, match="the web is the load model's"):
        bench.set_effect("web_slip", creep_per_N=1e-6)
    with pytest.raises(ValidationError, match="entry 1: effect 'elasticity_shift'"):
        stand(effects=[EffectEntry(effect="elasticity_shift", parameters={"relative_change": 0.1})])
    with pytest.raises(ValueError, match="expected at most the reflected roller's"):
        stand(load_motor=LoadMotorParameters(inertia_kg_m2=1.0))


def readings(seed: int) -> list[tuple[float, ...]]:
    bench, ports = stand(sensors=NOISY, seed=seed)
    ports[1].mode, ports[1].setpoint = MotorMode.VELOCITY, 20.0
    result = []
    for _ in range(300):
        bench.step(CYCLE_S)
        result.append(tuple(v for port in ports for v in (port.position_rad, port.velocity_rad_s, port.torque_Nm)))
    return result


def test_readings_repeat_with_the_seed_and_differ_between_seeds() -> None:
    assert readings(7) == readings(7)
    assert readings(7) != readings(8)


def test_noise_has_its_size_and_positions_are_whole_counts() -> None:
    rows = np.array(readings(7))
    assert np.std(rows[:, 2]) == pytest.approx(0.05, rel=0.15)
    assert np.std(rows[:, 1]) == pytest.approx(0.0025, rel=0.15)
    counts = rows[:, 3] / NOISY.encoder_rad_per_count
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_noise_does_not_depend_on_the_block_size() -> None:
    small, large = (SensorNoise(np.random.SeedSequence(3).spawn(2), block) for block in (7, 1000))
    rows = np.array([small.row() for _ in range(500)])
    assert rows.tobytes() == np.array([large.row() for _ in range(500)]).tobytes()
    assert np.abs(np.corrcoef(rows.T) - np.eye(6)).max() < 0.2  # every quantity has its own stream


def largest_inertia_ratio(shaft: SampledShaft) -> float:
    """Largest stable emulated over real inertia, by tau = -J_e·(v_k - v_{k-1})/T."""

    def radius(ratio: float) -> float:
        per_rate = np.array([ratio * shaft.inertia_kg_m2 / shaft.cycle_s])
        law = LinearLaw(np.zeros((1, 1)), np.array([[0.0, 1.0]]), per_rate, np.array([0.0, -per_rate[0]]))
        return spectral_radius_under(shaft, law)

    return largest_stable(radius, 100.0)


def emulate_inertia(ratio: float) -> np.ndarray:
    """Speed of shaft 2 after a nudge, with inertia emulated over the bus: set points act one cycle later."""
    bench, ports = stand()
    ports[1].mode, ports[2].mode = MotorMode.VELOCITY, MotorMode.TORQUE
    ports[1].setpoint = 1e-3
    before, speeds = 0.0, []
    for _ in range(3000):
        v = ports[1].velocity_rad_s
        bench.step(CYCLE_S)
        ports[2].setpoint = -ratio * INERTIA * (v - before) / CYCLE_S
        before = v
        speeds.append(v)
    return np.array(speeds) - 1e-3


def test_inertia_can_be_emulated_up_to_the_computed_limit_and_not_beyond() -> None:
    limit = largest_inertia_ratio(sampled_shaft(model()))
    below, above = emulate_inertia(0.97 * limit), emulate_inertia(1.03 * limit)
    assert np.abs(below[-200:]).max() < 0.1 * np.abs(below[:200]).max()
    assert np.abs(above[-200:]).max() > 10 * np.abs(above[:200]).max()


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_without_control_loops_only_as_much_inertia_as_there_is(delay: int) -> None:
    # d_{k+1} = -(J_e/J)·d_{k-delay} of the changes of speed d.
    shaft = SampledShaft(0.05, 0.0, 0.0, 0.0, 0.0, delay_cycles=delay)
    assert largest_inertia_ratio(shaft) == pytest.approx(1.0, rel=2e-3)


def emulate_web(lead_s: float) -> np.ndarray:
    """Tension while the load motor emulates the web at standstill and then at 1 m/s."""
    parameters = model(web_load=[False, True])
    ports = [MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.TORQUE)]
    bench = TestRig(RigParameters.matching(parameters, [CoupledMotor(axis=2)]), ports)
    web, tensions = LineFollower(parameters), []
    for k in range(1500):
        if k:
            web.follow([port.position_rad / RAD_PER_M for port in ports[:2]], CYCLE_S)
        (torque,) = web.load_torques_Nm([2], [port.velocity_rad_s / RAD_PER_M for port in ports[:2]], lead_s)
        bench.step(CYCLE_S)
        ports[2].setpoint = torque
        ports[0].setpoint = ports[1].setpoint = min(1.0, max(0.0, k * CYCLE_S - 1.0)) * RAD_PER_M
        tensions.append(web.tension_N[0])
    return np.array(tensions)


def test_the_web_can_be_emulated_only_with_the_delay_made_good() -> None:
    parameters = model()
    shaft = sampled_shaft(parameters)
    web = parameters.youngs_modulus_Pa(1) * parameters.section_m2(1) / parameters.span_length_m(1) / RAD_PER_M**2
    lead = emulation_delay_s(shaft)
    assert spectral_radius(shaft, web) > 1.0
    assert spectral_radius(shaft, web, lead) < 1.0
    assert largest_stiffness_Nm_per_rad(shaft) < web < 0.5 * largest_stiffness_Nm_per_rad(shaft, lead)
    assert np.ptp(emulate_web(0.0)[-300:]) > 50.0
    assert np.ptp(emulate_web(lead)[-300:]) < 5.0
