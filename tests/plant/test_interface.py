"""What holds for every machine behind the interface: closed models, simulated hardware, emulated machines."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from math import isfinite

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import find_effect
from hilbench.plant.interface import Follower, Machine, Plant, Quantity, checked_name
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis.emulation import EmulatedShaft
from hilbench.plant.servo_axis.parameters import ServoRigParameters
from hilbench.plant.servo_axis.shaft import ServoAxis, ServoRig
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, TestRig

from .models import effect, line_of, lone_axis, model
from .servo_axis import models as servo

CYCLE_S = 0.002
SPEEDS = st.floats(-20.0, 20.0)
NOISY = SensorParameters(torque_noise_Nm=0.05, velocity_noise_rad_s=0.002, encoder_rad_per_count=1e-5)
SLIPS = [effect("coulomb_friction", 1, force_N=2.0), effect("web_slip", creep_per_N=2e-6)]
PLAYS = [*SLIPS, effect("backlash", 2, gap_rad=0.01), effect("torque_delay", 2, delay_s=0.003)]


def line(parameters: ModelParameters) -> Line:
    return Line(parameters, [MotorPort() for _ in range(parameters.axis_count)])


def rig(parameters: ModelParameters, *load_axes: int) -> TestRig:
    load_motors = [CoupledMotor(axis=axis) for axis in load_axes]
    made = RigParameters.matching(parameters, load_motors, NOISY)
    return TestRig(made, [MotorPort() for _ in range(parameters.axis_count + len(load_axes))], seed=3)


def servo_rig() -> ServoRig:
    made = ServoRigParameters.matching(servo.axis(unbalance_Nm=0.1), sensors=NOISY)
    return ServoRig(made, [MotorPort(), MotorPort()], seed=3)


def emulated_shaft() -> EmulatedShaft:
    return EmulatedShaft(
        servo.axis(inertia_kg_m2=0.06, unbalance_Nm=0.1), ServoRigParameters.matching(servo.axis()), CYCLE_S
    )


PLANTS: dict[str, Callable[[], Plant]] = {
    "line": lambda: line(model(*PLAYS)),
    "line of three": lambda: line(line_of(3, *SLIPS)),
    "lone axis": lambda: line(lone_axis()),
    "rig": lambda: rig(model(), 2),
    "rig of three axes with two load motors": lambda: rig(line_of(3), 1, 3),
    "rig with two load motors on a shaft": lambda: rig(model(), 2, 2),
    "rig without a load motor": lambda: rig(lone_axis()),
    "servo axis": lambda: ServoAxis(servo.axis(unbalance_Nm=0.1), [MotorPort()]),
    "rig of a servo axis": servo_rig,
}
FOLLOWERS: dict[str, Callable[[], Follower]] = {
    "span": lambda: LineFollower(model(*SLIPS)),
    "three spans": lambda: LineFollower(line_of(4, *SLIPS)),
    "shaft": emulated_shaft,
}
MACHINES: dict[str, Callable[[], Machine]] = {**PLANTS, **FOLLOWERS}
every_machine = pytest.mark.parametrize("made", MACHINES.values(), ids=MACHINES)
every_plant = pytest.mark.parametrize("made", PLANTS.values(), ids=PLANTS)
every_follower = pytest.mark.parametrize("made", FOLLOWERS.values(), ids=FOLLOWERS)


def move(machine: Machine, speeds: Iterable[float]) -> list[dict[str, float]]:
    """Cycles at these speeds of the first axis, a motor's in rad/s; the outputs (and what ports show) after each."""
    found = []
    for speed in speeds:
        shown: dict[str, float] = {}
        if isinstance(machine, Follower):
            unit, axes = machine.describe().position_unit, machine.describe().axes
            outputs = machine.outputs()
            at = [outputs[f"x{k}_{unit}"] + 0.01 * speed * (1.0 + 1e-5 * k) * CYCLE_S for k in range(1, axes + 1)]
            machine.follow(at, CYCLE_S)
            shown = dict(enumerate(machine.load_torques_Nm([1, axes], [speed] * axes, 0.004)))  # type: ignore[arg-type]
        elif isinstance(machine, Plant):
            axes = machine.describe().axes
            for number, port in enumerate(machine.ports):
                port.mode = MotorMode.VELOCITY if number < axes else MotorMode.TORQUE
                port.setpoint = speed * (1.0 + 1e-5 * number) if number < axes else 0.01 * speed
            machine.step(CYCLE_S)
            for number, port in enumerate(machine.ports):
                shown |= {f"port{number} {name}": getattr(port, name) for name in FEEDBACK}
        found.append({**machine.outputs(), **shown})
    return found


FEEDBACK = ("position_rad", "velocity_rad_s", "torque_Nm", "reference", "torque_limited")


@every_machine
def test_description_names_what_there_is(made: Callable[[], Machine]) -> None:
    machine = made()
    described = machine.describe()
    assert list(machine.outputs()) == [quantity.name for quantity in described.outputs]
    assert list(machine.get_state().values) == [quantity.name for quantity in described.states]
    for name in (quantity.name for quantity in described.parameters):
        assert isfinite(machine.parameter(name))
    for group in (described.states, described.inputs, described.outputs, described.parameters):
        names = [quantity.name for quantity in group]
        assert len(set(names)) == len(names)
        assert all(quantity.unit and quantity.meaning for quantity in group)
    assert all(1 <= motor.axis <= described.axes and motor.rad_per_unit > 0.0 for motor in described.motors)
    assert [motor.axis for motor in described.motors[: described.axes]] in ([], list(range(1, described.axes + 1)))


@every_machine
def test_units_of_names_are_those_of_the_description(made: Callable[[], Machine]) -> None:
    described = made().describe()
    suffixes = {"N·m": "_Nm", "kg·m²": "_kg_m2", "m/s": "_m_s", "rad/s": "_rad_s", "rad/s²": "_rad_s2", "1": ""}
    suffixes["N·m·s/rad"] = "_Nm_s_per_rad"
    for quantity in (*described.states, *described.inputs, *described.outputs, *described.parameters):
        assert quantity.name.endswith(suffixes.get(quantity.unit, f"_{quantity.unit}")), quantity
    unit = described.position_unit
    motion = {f"x{k}_{unit}" for k in range(1, described.axes + 1)}
    motion |= {f"v{k}_{unit}_s" for k in range(1, described.axes + 1)}
    assert motion <= {quantity.name for quantity in described.states}
    assert motion <= {quantity.name for quantity in described.outputs}


@every_plant
def test_every_motor_of_a_plant_has_its_port(made: Callable[[], Plant]) -> None:
    plant = made()
    assert len(plant.ports) == len(plant.describe().motors)
    moved = move(plant, [5.0] * 200)[-1]
    unit = plant.describe().position_unit
    for port, motor in zip(plant.ports, plant.describe().motors, strict=True):
        assert port.velocity_rad_s == pytest.approx(moved[f"v{motor.axis}_{unit}_s"] * motor.rad_per_unit, abs=0.5)
        assert abs(port.velocity_rad_s) > 1.0


@every_machine
@settings(max_examples=8, deadline=None)
@given(
    before=st.lists(st.floats(-20.0, 20.0), max_size=12), after=st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=9)
)
def test_machine_goes_on_bit_for_bit_from_a_state_given_back(
    made: Callable[[], Machine], before: list[float], after: list[float]
) -> None:
    machine, other = made(), made()
    move(machine, before)
    state = machine.get_state()
    expected = move(machine, after)
    move(other, reversed(after))
    for each in (machine, other):
        each.set_state(state)
        assert move(each, after) == expected


@every_machine
def test_state_that_is_transferred_by_name_is_there_and_the_others_stay(made: Callable[[], Machine]) -> None:
    machine = made()
    move(machine, [3.0] * 20)
    for quantity in machine.describe().states:
        before = machine.get_state().values
        value = before[quantity.name] + (1e-5 if quantity.unit == "1" else 0.125)
        machine.set_state({quantity.name: value})
        assert machine.get_state().values == pytest.approx({**before, quantity.name: value}, rel=1e-12, abs=1e-12)


@every_machine
def test_parameter_that_is_set_acts_and_keeps_the_state(made: Callable[[], Machine]) -> None:
    for quantity in made().describe().parameters:
        machine, plain = made(), made()
        for each in (machine, plain):
            move(each, [3.0] * 20)
        value = 1.0 if machine.parameter(quantity.name) == 0.0 else 1.25 * machine.parameter(quantity.name)
        before = machine.get_state().values
        machine.set_parameter(quantity.name, value)
        assert machine.parameter(quantity.name) == value
        if quantity.name != "broken":
            assert machine.get_state().values == before
        assert move(machine, [4.0] * 5) != move(plain, [4.0] * 5)


@every_machine
def test_input_that_is_set_acts(made: Callable[[], Machine]) -> None:
    for quantity in made().describe().inputs:
        machine, plain = made(), made()
        for each in (machine, plain):
            move(each, [3.0] * 20)
        machine.set_input(quantity.name, {"1": 4e-4, "N": 60.0}.get(quantity.unit, 1e-3))
        assert move(machine, [4.0] * 5) != move(plain, [4.0] * 5)


@every_machine
def test_every_effect_of_the_description_can_be_given_and_taken_back(made: Callable[[], Machine]) -> None:
    for effect_id in made().describe().effects:
        machine, plain = made(), made()
        item = find_effect(effect_id, MachineKind(machine.describe().kind))
        values = {q.name: min(max(2.0 * q.neutral + 0.01, q.lower), q.upper) for q in item.parameters}
        axis = machine.describe().axes if item.per_axis else None
        machine.set_effect(effect_id, axis, **values)
        machine.clear_effect(effect_id, axis)
        plain.clear_effect(effect_id, axis)
        assert move(machine, [3.0] * 5) == move(plain, [3.0] * 5)


@every_machine
def test_unknown_names_are_refused_in_one_line(made: Callable[[], Machine]) -> None:
    machine = made()
    calls: dict[str, Callable[[], object]] = {
        "parameter": lambda: machine.parameter("mass_kg"),
        "parameter ": lambda: machine.set_parameter("mass_kg", 1.0),
        "input": lambda: machine.set_input("weather", 1.0),
        "state": lambda: machine.set_state({"mood": 1.0}),
        "effect": lambda: machine.set_effect("rust", 1),
        "effect ": lambda: machine.clear_effect("rust", 1),
    }
    before = machine.outputs()
    for kind, call in calls.items():
        with pytest.raises(ValueError, match=f"unknown {kind.strip()} '.*', expected") as caught:
            call()
        assert "\n" not in str(caught.value)
    assert machine.outputs() == before


@every_machine
@pytest.mark.parametrize("value", [-1e3, float("nan"), float("inf")])
def test_impossible_value_of_a_parameter_is_refused_and_changes_nothing(
    made: Callable[[], Machine], value: float
) -> None:
    machine = made()
    for quantity in machine.describe().parameters:
        if quantity.unit == "rad" and isfinite(value):
            continue  # every angle is one
        before = machine.parameter(quantity.name)
        with pytest.raises(ValueError, match=f"{quantity.name} = .*, expected"):
            machine.set_parameter(quantity.name, value)
        assert machine.parameter(quantity.name) == before


@every_machine
def test_state_of_another_machine_is_refused(made: Callable[[], Machine]) -> None:
    machine = made()
    with pytest.raises(ValueError, match="a state of another machine, expected one of"):
        machine.set_state(replace(machine.get_state(), memory=None))


@every_plant
def test_duration_that_is_no_multiple_of_the_sample_time_is_refused(made: Callable[[], Plant]) -> None:
    with pytest.raises(ValueError, match="multiple of the drives' sample time"):
        made().step(0.0015)


@every_follower
def test_reset_brings_an_emulated_machine_back_to_the_start_at_any_place(made: Callable[[], Follower]) -> None:
    machine, fresh = made(), made()
    axes = machine.describe().axes
    move(machine, [3.0] * 20)
    for each in (machine, fresh):
        each.reset([2.0] * axes)
    there, expected = machine.get_state().values, fresh.get_state().values
    assert there == pytest.approx(expected, abs=1e-15)


def test_unknown_name_is_refused_with_the_names_there_are() -> None:
    known = (Quantity("youngs_modulus_Pa", "Pa", "E"), Quantity("inertia1_kg_m2", "kg·m²", "of the roller"))
    assert checked_name("parameter", "youngs_modulus_Pa", known) == "youngs_modulus_Pa"
    meant = "unknown parameter 'youngs_modulus', did you mean 'youngs_modulus_Pa'?"
    with pytest.raises(ValueError, match=re.escape(f"{meant} Expected one of youngs_modulus_Pa, inertia1_kg_m2")):
        checked_name("parameter", "youngs_modulus", known)
    with pytest.raises(ValueError, match="unknown input 'x', expected none"):
        checked_name("input", "x", ())


def test_noise_goes_on_where_a_state_was_taken() -> None:
    plant = rig(model(), 2)
    move(plant, [3.0] * 1000)
    state = plant.get_state()
    first = move(plant, [3.0] * 1100)  # more numbers than one block of the noise
    later = move(plant, [3.0] * 1100)
    plant.set_state(state)
    assert move(plant, [3.0] * 1100) == first
    noise = [np.array([row["port0 torque_Nm"] for row in rows]) for rows in (first, later)]
    assert np.std(noise[0] - noise[1]) > 0.04
