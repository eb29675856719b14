"""A servo axis as a plant: its names, states, parameters and effects; its file; the simulated hardware."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from hilbench.errors import UnusableInputError
from hilbench.plant.interface import Plant
from hilbench.plant.model_file import load_machine
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis.effects import IDS
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters, ShaftParameters
from hilbench.plant.servo_axis.shaft import ServoAxis, ServoRig, Shaft

from .models import axis, effect

CYCLE_S = 0.002
SIZES = {"torque_delay": (0.003,), "resonance": (0.3, 25.0)}
NOISY = SensorParameters(torque_noise_Nm=0.05, velocity_noise_rad_s=0.0025, encoder_rad_per_count=2 * np.pi / 2**20)


def closed() -> tuple[ServoAxis, list[MotorPort]]:
    ports = [MotorPort(mode=MotorMode.VELOCITY)]
    return ServoAxis(axis(), ports), ports


def hardware(seed: int = 3, **given: Any) -> tuple[ServoRig, list[MotorPort]]:
    ports = [MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.TORQUE)]
    return ServoRig(ServoRigParameters.matching(axis(), sensors=NOISY, **given), ports, seed), ports


def swing(machine: Shaft, ports: list[MotorPort], cycles: int) -> list[tuple[float, ...]]:
    shown = []
    for cycle in range(cycles):
        ports[0].setpoint = 10.0 * np.sin(0.05 * cycle)
        machine.step(CYCLE_S)
        shown.append(tuple(v for port in ports for v in (port.position_rad, port.velocity_rad_s, port.torque_Nm)))
    return shown


@pytest.mark.parametrize("build", [closed, hardware])
def test_names_of_the_description_are_those_of_outputs_and_states(build: Any) -> None:
    machine, ports = build()
    description = machine.describe()
    assert isinstance(machine, Plant)
    assert (description.kind, description.position_unit, description.axes) == ("servo_axis", "rad", 1)
    assert len(description.motors) == len(machine.ports) == len(ports)
    assert list(machine.outputs()) == [quantity.name for quantity in description.outputs]
    assert list(machine.get_state().values) == [quantity.name for quantity in description.states]
    assert description.outputs[0].unit == "rad"
    for quantity in description.parameters:
        machine.set_parameter(quantity.name, 0.07)
        assert machine.parameter(quantity.name) == 0.07


@pytest.mark.parametrize("build", [closed, hardware])
def test_goes_on_from_a_state_bit_for_bit(build: Any) -> None:
    machine, ports = build()
    swing(machine, ports, 50)
    state = machine.get_state()
    first = swing(machine, ports, 60)
    machine.set_state(state)
    assert swing(machine, ports, 60) == first
    other, ports = build()
    other.set_state(state)
    assert swing(other, ports, 60) == first


def test_measured_motion_is_transferred_by_name() -> None:
    machine, ports = closed()
    machine.set_state({"x1_rad": 3.0, "v1_rad_s": -5.0, "tau1_Nm": -0.22})
    assert (ports[0].position_rad, ports[0].velocity_rad_s, ports[0].torque_Nm) == (3.0, -5.0, -0.22)
    ports[0].mode, ports[0].setpoint = MotorMode.VELOCITY, -5.0
    machine.step(0.001)
    assert machine.outputs()["v1_rad_s"] == pytest.approx(-5.0, abs=0.01)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m: m.parameter("inertia"), "unknown parameter 'inertia', did you mean 'inertia_kg_m2'?"),
        (lambda m: m.set_parameter("inertia_kg_m2", 0.0), "inertia_kg_m2 = 0.0 kg·m², expected more than 0"),
        (lambda m: m.set_parameter("coulomb_friction_Nm", -0.1), "expected 0 or more"),
        (lambda m: m.set_parameter("unbalance_phase_rad", float("nan")), "expected a finite number"),
        (lambda m: m.set_input("F_next_N", 1.0), "unknown input 'F_next_N', expected one of external_torque_Nm"),
        (lambda m: m.set_state({"x1_m": 1.0}), "unknown state 'x1_m', did you mean 'x1_rad'?"),
        (lambda m: m.set_effect("web_slip", creep_per_N=1e-5), "web_slip"),
        (lambda m: m.set_effect("torque_offset", 2, offset_Nm=0.1), "axis 2, expected 1 to 1"),
        (lambda m: m.set_effect("torque_ripple", 1, slot=9, amplitude_Nm=0.1, order=1.0), "slot 9, expected 0 to"),
        (lambda m: m.set_effect("coulomb_friction", 1, force_N=1.0), "no parameter 'force_N', expected torque_Nm"),
        (lambda m: m.clear_effect("roller_eccentricity", 1), "roller_eccentricity"),
        (lambda m: m.step(0.0015), "expected a multiple of the drives' sample time"),
    ],
)
def test_what_a_servo_axis_does_not_have_is_refused_in_one_line(call: Any, said: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        call(closed()[0])
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_delayed_torque_is_the_torque_of_before() -> None:
    plain, late = (np.array(swing(*closed_with(*given), 200))[:, 2] for given in ((), (effect("torque_delay", 0.004),)))
    np.testing.assert_array_equal(late[2:], plain[:-2])
    with pytest.raises(ValueError, match=r"torque_delay' of 0.05 s, expected at most 0.0126 s"):
        ServoAxis(axis(effect("torque_delay", 0.05), drives={"sample_time_s": 1e-4}))


def closed_with(*effects: dict[str, Any]) -> tuple[ServoAxis, list[MotorPort]]:
    ports = [MotorPort(mode=MotorMode.VELOCITY)]
    return ServoAxis(axis(*effects), ports), ports


@pytest.mark.parametrize("effect_id", IDS)
def test_each_effect_changes_what_is_measured_and_is_gone_when_cleared(effect_id: str) -> None:
    parameters = effect(effect_id, *SIZES.get(effect_id, (0.1, 2.0)))["parameters"]
    machine, ports = closed()
    start = machine.get_state()
    plain = swing(machine, ports, 200)
    machine.set_state(start)
    machine.set_effect(effect_id, 1, **parameters)
    assert swing(machine, ports, 200) != plain
    machine.set_state(start)
    machine.clear_effect(effect_id, 1)
    assert swing(machine, ports, 200) == plain
    with_model = ServoAxis(axis(effect(effect_id, *SIZES.get(effect_id, (0.1, 2.0)))), ports)
    machine.set_state(start)
    machine.set_effect(effect_id, 1, **parameters)
    assert swing(with_model, ports, 200) == swing(machine, ports, 200)


def test_friction_that_begins_under_way_does_not_stop_a_turning_shaft() -> None:
    port = MotorPort(mode=MotorMode.TORQUE, setpoint=1.0)
    machine = ServoAxis(axis(coulomb_friction_Nm=0.0), [port])
    machine.step(0.1)
    port.setpoint = -1.0
    machine.step(0.4)
    speed = port.velocity_rad_s
    assert speed < -1.0
    machine.set_parameter("coulomb_friction_Nm", 0.2)
    machine.step(0.001)
    assert port.velocity_rad_s == pytest.approx(speed, abs=0.05)


def test_load_motor_and_drive_turn_the_same_shaft() -> None:
    ports = [MotorPort(mode=MotorMode.TORQUE, setpoint=1.0), MotorPort(mode=MotorMode.TORQUE, setpoint=-0.4)]
    load = LoadMotorParameters(inertia_kg_m2=0.01)
    shaft = ShaftParameters(inertia_kg_m2=0.02)
    rig = ServoRig(ServoRigParameters.matching(axis(), shaft, load), ports)
    rig.step(1.0)
    assert rig.outputs()["v1_rad_s"] == pytest.approx(0.6 / 0.031 * 0.999, rel=1e-4)
    assert ports[1].velocity_rad_s == ports[0].velocity_rad_s
    assert (ports[0].torque_Nm, ports[1].torque_Nm) == (pytest.approx(1.0), pytest.approx(-0.4))


def test_stand_that_matches_its_model_turns_as_the_model_with_the_load_motor_idle() -> None:
    model, model_ports = closed()
    ports = [MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.TORQUE)]
    rig = ServoRig(ServoRigParameters.matching(axis(), load_motor=LoadMotorParameters(inertia_kg_m2=0.03)), ports)
    on_rig = np.array(swing(rig, ports, 300))
    np.testing.assert_allclose(on_rig[:, :3], swing(model, model_ports, 300), atol=1e-9)
    with pytest.raises(ValueError, match="expected at most the shaft's"):
        ServoRigParameters.matching(axis(), load_motor=LoadMotorParameters(inertia_kg_m2=0.2))


def test_equal_seeds_give_equal_readings_and_others_give_others() -> None:
    readings = [swing(*hardware(seed), 200) for seed in (1, 1, 2)]
    assert readings[0] == readings[1]
    assert readings[0] != readings[2]
    torque = np.array(readings[0])[:, 2] - np.array(readings[2])[:, 2]
    assert np.std(torque) == pytest.approx(0.05 * np.sqrt(2.0), rel=0.2)


def test_model_file_says_by_its_kind_which_machine_it_is(tmp_path: Path) -> None:
    file = tmp_path / "axis.yaml"
    file.write_text("kind: servo_axis\nshaft: {inertia_kg_m2: 0.05, coulomb_friction_Nm: 0.1}\n")
    machine = load_machine(file)
    assert isinstance(machine, ServoAxisParameters)
    assert machine.inertia_kg_m2 == 0.05
    file.write_text("rollers: {radius_m: 0.2, inertia_kg_m2: 1.0}\n")
    assert load_machine(file).axis_count == 1
    file.write_text("kind: web_line\nrollers: {radius_m: 0.2, inertia_kg_m2: 1.0}\n")
    assert load_machine(file).axis_count == 1
    file.write_text("kind: servo_axes\nshaft: {inertia_kg_m2: 0.05}\n")
    with pytest.raises(UnusableInputError, match=r"axis\.yaml:1.*'servo_axes', did you mean 'servo_axis'\?"):
        load_machine(file)
    file.write_text("kind: servo_axis\nshaft:\n  inertia_kg_m2: 0.05\n  coulomb_friction_N: 0.1\n")
    with pytest.raises(UnusableInputError, match=r"axis\.yaml:4.*coulomb_friction_N"):
        load_machine(file)


def test_impossible_shafts_are_refused() -> None:
    with pytest.raises(ValidationError, match="no inertia"):
        ServoAxisParameters.model_validate({"shaft": {"inertia_kg_m2": 0.0}})
    with pytest.raises(ValidationError, match="one drive"):
        axis(drives={"torque_limit_Nm": [9.0, 8.0]})
    with pytest.raises(ValidationError, match="unknown effect 'web_slip', expected one of coulomb_friction"):
        axis({"effect": "web_slip", "parameters": {"creep_per_N": 1e-6}})
    with pytest.raises(ValidationError, match="given more than 1 times"):
        axis(effect("torque_offset", 0.1), effect("torque_offset", 0.2))


@pytest.mark.parametrize("build", [closed, hardware])
def test_a_shaft_goes_on_alike_with_its_ports_and_by_set_points_alone(build: Any) -> None:
    """Signs of zeros, limits and sensors, too: bit by bit."""
    shown: list[list[tuple[float, ...]]] = [[], []]
    outputs: list[dict[str, float]] = []
    for way, kept in enumerate(shown):
        machine, ports = build()
        ports[0].torque_limit_Nm = 1.5
        set_points, numbers = np.zeros(len(ports)), np.zeros(5 * len(ports))
        step = machine.steps_in_modes(set_points, CYCLE_S, numbers)
        assert step is not None
        for row in range(60):
            set_points[:] = 0.0 if row < 5 else [0.1 * row * (-1) ** (row // 20), 0.2][: len(ports)]
            for port, value in zip(ports, set_points.tolist(), strict=True):
                port.setpoint = value
            if way:
                step()
                kept += [tuple(numbers[at : at + 5]) for at in range(0, len(numbers), 5)]
            else:
                machine.step(CYCLE_S)
                kept += [(p.position_rad, p.velocity_rad_s, p.torque_Nm, p.reference, p.torque_limited) for p in ports]
        outputs.append(machine.outputs())
    by_ports, in_modes = (np.array(kept, float) for kept in shown)
    assert by_ports.tobytes() == in_modes.tobytes()
    assert outputs[0] == outputs[1]
    assert by_ports[:, 4].any()
    assert not by_ports[:, 4].all()
