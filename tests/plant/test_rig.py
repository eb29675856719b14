"""Simulated hardware of any topology: three axes and two load motors against DOP853 on the equations, written here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.parameters import EffectEntry, LoadMotorParameters
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, TestRig

from .models import line_of, lone_axis, model

CYCLE_S = 0.002
GEAR = 5.0
RADIUS_M = np.array([0.2, 0.19, 0.18])
INERTIA_KG_M2 = np.array([1.167, 1.267, 1.367]) / GEAR**2 + 0.001  # at the motor, load rotors within
LOAD_AXES = (2, 1)
LAG_S = np.array([0.001, 0.001, 0.001, 0.0015, 0.003])  # of the motors' current loops: three axes, two load motors
TWO = (
    CoupledMotor(axis=2, motor=LoadMotorParameters(inertia_kg_m2=0.01, current_loop_time_constant_s=0.0015)),
    CoupledMotor(axis=1, motor=LoadMotorParameters(inertia_kg_m2=0.004, current_loop_time_constant_s=0.003)),
)
HIDDEN = (
    EffectEntry(effect="viscous_friction", axis=1, parameters={"coefficient_N_s_per_m": 3.0}),
    EffectEntry(effect="friction_asymmetry", axis=3, parameters={"viscous_difference_N_s_per_m": 1.5}),
    EffectEntry(effect="torque_ripple", axis=2, parameters={"amplitude_Nm": 0.3, "order": 2.0, "phase_rad": 0.4}),
    EffectEntry(effect="inertia_mismatch", axis=2, parameters={"relative_change": 0.15}),
)


def rig(
    load_motors: Sequence[CoupledMotor] = TWO,
    effects: Sequence[EffectEntry] = (),
    parameters: ModelParameters | None = None,
) -> tuple[TestRig, list[MotorPort]]:
    """A rig of a model's axes (default: three that differ), with a port for each motor."""
    parameters = parameters or line_of(3)
    ports = [MotorPort(mode=MotorMode.TORQUE) for _ in range(parameters.axis_count + len(load_motors))]
    return TestRig(RigParameters.matching(parameters, load_motors, effects=effects), ports, substeps=4), ports


def reference(commands: np.ndarray) -> np.ndarray:
    """Angles and speeds (n, 6) at the rows, torques held for a row each; of the rig with all that is hidden in it."""
    per_m = GEAR / RADIUS_M
    inertia = INERTIA_KG_M2 * np.array([1.0, 1.15, 1.0])

    def rates(_: float, y: np.ndarray, command: np.ndarray) -> np.ndarray:
        angle, speed, torque = y[:3], y[3:6], y[6:]
        shaft = torque[:3].copy()
        shaft[1] += 0.3 * np.sin(2.0 * angle[1] + 0.4)
        for axis, load in zip(LOAD_AXES, torque[3:], strict=True):
            shaft[axis - 1] += load
        at_the_web_m_s = speed / per_m
        resistance_N = np.array([3.0 * at_the_web_m_s[0], 0.0, 1.5 * abs(at_the_web_m_s[2])])
        return np.concatenate([speed, (shaft - resistance_N / per_m) / inertia, (command - torque) / LAG_S])

    y, found = np.zeros(11), []
    for command in commands:
        found.append(y[:6])
        y = solve_ivp(rates, (0.0, CYCLE_S), y, method="DOP853", rtol=1e-11, atol=1e-14, args=(command,)).y[:, -1]
    return np.array(found)


def test_three_axes_with_two_load_motors_turn_as_the_equations_say() -> None:
    rows = 300
    t = np.arange(rows) * CYCLE_S
    commands = np.column_stack([(0.5 + 0.2 * j) * np.sin((5.0 + 2.0 * j) * t + j) for j in range(5)])
    plant, ports = rig(effects=HIDDEN)
    found, shown = [], []
    for row in commands:
        outputs = plant.outputs()
        found.append([outputs[f"x{k}_rad"] for k in (1, 2, 3)] + [outputs[f"v{k}_rad_s"] for k in (1, 2, 3)])
        shown.append([port.position_rad for port in ports])
        for port, torque in zip(ports, row, strict=True):
            port.setpoint = torque
        plant.step(CYCLE_S)
    expected = reference(commands)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)  # what steps of 0.25 ms leave of lags of 1 ms
    on_shafts = [0, 1, 2, *(axis - 1 for axis in LOAD_AXES)]
    np.testing.assert_allclose(shown, expected[:, on_shafts], rtol=0, atol=1e-8)
    assert np.ptp(expected[:, 3:], axis=0).min() > 1.0  # the comparison has something to compare


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_load_motor_turns_the_shaft_that_it_is_on_and_no_other(axis: int) -> None:
    plant, ports = rig([CoupledMotor(axis=axis)])
    ports[-1].setpoint = 0.5
    plant.step(0.5)
    outputs = plant.outputs()
    assert outputs[f"v{axis}_rad_s"] > 1.0
    assert ports[-1].velocity_rad_s == outputs[f"v{axis}_rad_s"]
    assert all(outputs[f"v{other}_rad_s"] == 0.0 for other in {1, 2, 3} - {axis})


def test_load_motors_on_one_shaft_add_up() -> None:
    alone, (_, _, only) = rig([CoupledMotor(axis=1)], parameters=model())
    both, (_, _, one, other) = rig([CoupledMotor(axis=1), CoupledMotor(axis=1)], parameters=model())
    only.setpoint, one.setpoint, other.setpoint = 0.5, 0.7, -0.2
    for plant in (alone, both):
        plant.step(0.3)
    assert both.outputs()["v1_rad_s"] == pytest.approx(alone.outputs()["v1_rad_s"], rel=1e-12)


def test_rotor_of_a_load_motor_counts_to_the_shaft_as_the_flywheel_did() -> None:
    heavy = [CoupledMotor(axis=1, motor=LoadMotorParameters(inertia_kg_m2=0.02))]
    speeds = []
    for load_motors in ([], heavy):
        plant, ports = rig(load_motors, parameters=lone_axis())
        ports[0].setpoint = 1.0
        plant.step(0.5)
        speeds.append(plant.outputs()["v1_rad_s"])
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-12)


def test_friction_is_hidden_in_the_axis_it_is_given_for() -> None:
    hidden = EffectEntry(effect="coulomb_friction", axis=3, parameters={"force_N": 5.0})
    plant, ports = rig(effects=[hidden])
    for port in ports[:3]:
        port.mode, port.setpoint = MotorMode.VELOCITY, 10.0
    plant.step(3.0)
    torques = [port.torque_Nm for port in ports[:3]]
    assert torques == pytest.approx([0.0, 0.0, 5.0 * RADIUS_M[2] / GEAR], abs=1e-4)


def test_rigs_that_cannot_be_are_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match="a load motor on axis 4, expected 1 to 3"):
        rig([CoupledMotor(axis=4)])
    with pytest.raises(ValueError, match="expected at most the reflected roller's"):
        rig([CoupledMotor(axis=1, motor=LoadMotorParameters(inertia_kg_m2=0.03))] * 2)
    with pytest.raises(ValidationError, match="effect 'coulomb_friction' with axis 4, expected 1 to 3"):
        rig(effects=[EffectEntry(effect="coulomb_friction", axis=4, parameters={"force_N": 5.0})])
    with pytest.raises(ValueError, match="4 ports, expected those of 3 axes and 2 load motors"):
        TestRig(RigParameters.matching(line_of(3), TWO), [MotorPort() for _ in range(4)])
    given = RigParameters.matching(line_of(3), TWO).model_dump()
    with pytest.raises(ValidationError, match="radius_m has 2 values, expected one or 3"):
        RigParameters.model_validate({**given, "radius_m": [0.2, 0.2]})


@pytest.mark.parametrize("kind", ["rig", "line"])
def test_a_machine_goes_on_alike_with_its_ports_and_by_set_points_alone(kind: str) -> None:
    """Signs of zeros, limits and sensors, too: bit by bit."""
    shown: list[list[tuple[float, ...]]] = [[], []]
    for way, kept in enumerate(shown):
        machine: TestRig | Line
        if kind == "rig":
            parameters = RigParameters.matching(line_of(3), TWO)
            noisy = SensorParameters(torque_noise_Nm=0.1, position_noise_rad=1e-4, encoder_rad_per_count=1e-5)
            ports = [MotorPort(mode=MotorMode.TORQUE, torque_limit_Nm=1.5) for _ in range(5)]
            machine = TestRig(parameters.model_copy(update={"sensors": noisy}), ports, seed=3)
        else:
            ports = [MotorPort(mode=MotorMode.VELOCITY, torque_limit_Nm=1.5) for _ in range(3)]
            machine = Line(line_of(3), ports)
        set_points, numbers = np.zeros(len(ports)), np.zeros(5 * len(ports))
        machine.step(CYCLE_S)  # the modes are known from here on
        step = machine.steps_in_modes(set_points, CYCLE_S, numbers)
        for row in range(60):
            set_points[:] = 0.0 if row < 5 else [0.04 * row * (-1) ** at for at in range(len(ports))]
            for port, value in zip(ports, set_points.tolist(), strict=True):
                port.setpoint = value
            if way:
                step()
                kept += [tuple(numbers[at : at + 5]) for at in range(0, len(numbers), 5)]
            else:
                machine.step(CYCLE_S)
                kept += [(p.position_rad, p.velocity_rad_s, p.torque_Nm, p.reference, p.torque_limited) for p in ports]
    by_ports, in_modes = (np.array(kept, float) for kept in shown)
    assert by_ports.tobytes() == in_modes.tobytes()
    assert by_ports[:, 4].any()
    assert not by_ports[:, 4].all()
