"""The servo axis against scipy's DOP853 on the equations as they are written, closed forms and balances."""

from __future__ import annotations

from math import exp, log

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.offline import simulate
from hilbench.plant.servo_axis.shaft import ServoAxis

from .models import axis, effect

ROW_S = 0.002
J, TC, B = 0.048, 0.2, 0.004


def test_kernel_solves_the_equations_as_written() -> None:
    entries = [
        effect("coulomb_friction", 0.1),
        effect("viscous_friction", 0.003),
        effect("stribeck_friction", 0.15, 4.0),
        effect("friction_asymmetry", 0.001),
        effect("torque_ripple", 0.05, 3.0, 0.4),
        effect("torque_ripple", 0.03, 7.0),
        effect("torque_scale", 0.06),
        effect("inertia_mismatch", 0.1),
        effect("torque_offset", 0.02),
        effect("unbalance", 0.1, -0.4),
    ]
    parameters = lay.pack(axis(*entries, unbalance_Nm=0.3, unbalance_phase_rad=0.7, gear_ratio=2.0), substeps=4)
    commands = 2.0 * np.sin(9.0 * np.arange(300) * ROW_S)
    outside = -0.1

    def derivative(_: float, y: np.ndarray, command: float, direction: float) -> list[float]:
        x, v, tau = y
        torque = 1.06 * tau + 0.05 * np.sin(3.0 * x + 0.4) + 0.03 * np.sin(7.0 * x)
        torque += 0.3 * np.sin(x / 2.0 + 0.7) + 0.1 * np.sin(x / 2.0 - 0.4) + outside
        friction = (B + 0.003) * v + 0.001 * abs(v) + (TC + 0.1 + 0.15 * np.exp(-((v / 4.0) ** 2))) * direction
        return [v, (torque - friction) / (J * 1.1), (command - tau) / 0.001]

    # Fast enough never to stand: the sign of dry friction stays.
    start = lay.new_state(parameters, v_rad_s=60.0)
    result = simulate(parameters, start, commands, ROW_S, MotorMode.TORQUE, outside)
    y, states = np.array([0.0, 60.0, 0.0]), []
    for command in commands:
        states.append(y)
        y = solve_ivp(derivative, (0.0, ROW_S), y, method="DOP853", rtol=1e-12, atol=1e-13, args=(command, 1.0)).y[
            :, -1
        ]
    x, v, tau = np.array(states).T
    assert v.min() > 1.0
    np.testing.assert_allclose(result.x_rad, x, atol=1e-9)
    np.testing.assert_allclose(result.v_rad_s, v, atol=1e-8)
    np.testing.assert_allclose(result.tau_Nm, tau + 0.02, atol=1e-12)


def test_shaft_that_reverses_agrees_with_an_integrator_that_stops_at_each_standstill() -> None:
    """Amplitude beyond breakaway: it slides to a stop, sticks, and breaks loose again, both ways."""
    model = axis(drives={"current_loop_time_constant_s": 0.0})
    t = np.arange(1500) * ROW_S
    commands = 0.26 * np.sin(2.0 * np.pi * 0.8 * t)
    result = simulate(lay.pack(model), lay.new_state(lay.pack(model)), commands, ROW_S, MotorMode.TORQUE)

    def standstill(_: float, y: np.ndarray, *__: float) -> float:
        return float(y[1])

    standstill.terminal = True  # type: ignore[attr-defined]
    x, v, direction, xs, vs = 0.0, 0.0, 0.0, [], []
    for command in commands:
        xs.append(x)
        vs.append(v)
        left = ROW_S
        while left > 1e-15:
            if direction == 0.0:
                if abs(command) <= TC:
                    break
                direction = float(np.sign(command))

            def slide(_: float, y: np.ndarray, command: float = command, direction: float = direction) -> list[float]:
                return [y[1], (command - B * y[1] - TC * direction) / J]

            # From just behind standstill, so that the start is no event.
            v = v or 1e-300 * direction
            solution = solve_ivp(slide, (0.0, left), [x, v], "DOP853", rtol=1e-12, atol=1e-15, events=standstill)
            ended_at = [time for time in solution.t_events[0] if time > 1e-12]
            x, v = solution.y[:, -1]
            if not ended_at or solution.t[-1] >= left:
                break
            left -= solution.t[-1]
            v, direction = 0.0, 0.0
    stands = np.array(vs) == 0.0
    assert 100 < stands.sum() < 1400
    np.testing.assert_allclose(result.v_rad_s, vs, atol=2e-8)
    np.testing.assert_allclose(result.x_rad, xs, atol=1e-8)


def test_coast_down_follows_the_closed_form_and_ends_at_standstill_for_good() -> None:
    model = axis()
    state = lay.new_state(lay.pack(model), v_rad_s=30.0)
    result = simulate(lay.pack(model), state, np.zeros(6000), ROW_S, MotorMode.OFF)
    stop_s = J / B * log(1.0 + B * 30.0 / TC)
    t = np.arange(6000) * ROW_S
    v = np.where(t < stop_s, (30.0 + TC / B) * np.exp(-B / J * t) - TC / B, 0.0)
    np.testing.assert_allclose(result.v_rad_s, v, atol=1e-9)
    way = J / B * (30.0 + TC / B) * (1.0 - exp(-B / J * stop_s)) - TC / B * stop_s
    assert result.x_rad[-1] == pytest.approx(way, rel=1e-9)
    assert np.all(result.v_rad_s[t > stop_s + ROW_S] == 0.0)


def test_coulomb_friction_alone_stops_a_shaft_after_j_v_over_tc() -> None:
    parameters = lay.pack(axis(viscous_friction_Nm_s_per_rad=0.0))
    state = lay.new_state(parameters, v_rad_s=-20.0)
    result = simulate(parameters, state, np.zeros(4000), ROW_S, MotorMode.OFF)
    assert result.x_rad[-1] == pytest.approx(-J * 20.0**2 / (2.0 * TC), rel=1e-9)
    assert np.flatnonzero(result.v_rad_s == 0.0)[0] == pytest.approx(J * 20.0 / TC / ROW_S, abs=1.0)


def test_torque_step_runs_through_the_current_loop_into_the_shaft() -> None:
    model = axis(coulomb_friction_Nm=0.0, viscous_friction_Nm_s_per_rad=0.0)
    result = simulate(lay.pack(model), lay.new_state(lay.pack(model)), np.ones(500), ROW_S, MotorMode.TORQUE)
    t = np.arange(500) * ROW_S
    v = (t - 0.001 * (1.0 - np.exp(-t / 0.001))) / J
    np.testing.assert_allclose(result.tau_Nm, 1.0 - np.exp(-t / 0.001), atol=1e-12)
    # A step of 1 ms of the fourth order through a lag of 1 ms.
    np.testing.assert_allclose(result.v_rad_s, v, atol=1e-4)


def test_velocity_loop_holds_its_speed_and_the_torque_shows_the_friction() -> None:
    port = MotorPort(mode=MotorMode.VELOCITY, setpoint=20.0)
    machine = ServoAxis(axis(), [port])
    machine.step(3.0)
    assert port.velocity_rad_s == pytest.approx(20.0, abs=1e-6)
    assert port.torque_Nm == pytest.approx(TC + B * 20.0, abs=1e-6)
    machine.set_input("external_torque_Nm", -0.5)
    machine.step(3.0)
    assert port.torque_Nm == pytest.approx(TC + B * 20.0 + 0.5, abs=1e-6)


def test_unbalance_swings_the_torque_once_a_turn_of_what_is_behind_the_gear() -> None:
    model = axis(unbalance_Nm=0.4, gear_ratio=3.0)
    result = simulate(lay.pack(model), lay.new_state(lay.pack(model)), np.full(8000, 6.0), ROW_S)
    x, tau = result.x_rad[4000:], result.tau_Nm[4000:]
    waves = np.column_stack([np.ones(len(x)), np.sin(x / 3.0), np.cos(x / 3.0)])
    fit = np.linalg.lstsq(waves, tau, rcond=None)[0]
    assert fit == pytest.approx([TC + 6.0 * B, -0.4, 0.0], abs=2e-2)


def test_pendulum_keeps_its_energy() -> None:
    """Without friction an unbalanced shaft is a pendulum: ½Jv² + A·cos(phi) is constant."""
    parameters = lay.pack(
        axis(coulomb_friction_Nm=0.0, viscous_friction_Nm_s_per_rad=0.0, unbalance_Nm=0.5), substeps=2
    )
    state = lay.new_state(parameters, x_rad=0.5)
    result = simulate(parameters, state, np.zeros(5000), ROW_S, MotorMode.OFF)
    energy = 0.5 * J * result.v_rad_s**2 + 0.5 * np.cos(result.x_rad)
    assert np.ptp(result.v_rad_s) > 5.0
    np.testing.assert_allclose(energy, energy[0], atol=1e-9)


def test_work_of_the_motor_is_kinetic_energy_and_what_friction_took() -> None:
    parameters = lay.pack(axis(drives={"current_loop_time_constant_s": 0.0}))
    t = np.arange(3000) * 0.001
    commands = 1.2 * np.sin(5.0 * t)
    result = simulate(parameters, lay.new_state(parameters), commands, 0.001, MotorMode.TORQUE)
    v = result.v_rad_s
    work = np.sum(commands[:-1] * np.diff(result.x_rad))
    # Simpson over pairs of rows; dry friction acts along the way.
    viscous = B * np.sum((v[:-2:2] ** 2 + 4.0 * v[1:-1:2] ** 2 + v[2::2] ** 2) * 0.001 / 3.0)
    dry = TC * np.sum(np.abs(np.diff(result.x_rad)))
    assert work == pytest.approx(0.5 * J * v[-1] ** 2 + viscous + dry, rel=1e-3)


@settings(max_examples=40, deadline=None)
@given(
    torque=st.floats(-0.199, 0.199),
    speed=st.floats(-3.0, 3.0),
    inertia=st.floats(1e-4, 1.0),
    viscous=st.just(0.0) | st.floats(1e-6, 0.05),
)
def test_less_than_breakaway_never_keeps_a_shaft_turning(
    torque: float, speed: float, inertia: float, viscous: float
) -> None:
    parameters = lay.pack(
        axis(inertia_kg_m2=inertia, viscous_friction_Nm_s_per_rad=viscous, drives={"current_loop_time_constant_s": 0.0})
    )
    state = lay.new_state(parameters, v_rad_s=speed)
    longest_s = (inertia + 0.001) * 3.0 / (TC - abs(torque))
    rows = int(longest_s / ROW_S) + 2
    if rows > 50000:
        return
    result = simulate(parameters, state, np.full(rows, torque), ROW_S, MotorMode.TORQUE)
    end = simulate(parameters, result.state, np.full(10, torque), ROW_S, MotorMode.TORQUE)
    assert np.all(end.v_rad_s == 0.0)
    assert np.ptp(end.x_rad) == 0.0
    assert np.all(np.diff(np.abs(result.v_rad_s)) <= 1e-12)


@settings(max_examples=25, deadline=None)
@given(
    frequency=st.floats(0.2, 20.0),
    amplitude=st.floats(0.0, 60.0),
    unbalance=st.just(0.0) | st.floats(1e-6, 1.0),
    mode=st.sampled_from([MotorMode.VELOCITY, MotorMode.POSITION, MotorMode.TORQUE]),
)
def test_mirrored_commands_give_the_mirrored_motion(
    frequency: float, amplitude: float, unbalance: float, mode: MotorMode
) -> None:
    parameters = lay.pack(axis(unbalance_Nm=unbalance))
    commands = amplitude * np.sin(2.0 * np.pi * frequency * np.arange(400) * ROW_S)
    one = simulate(parameters, lay.new_state(parameters), commands, ROW_S, mode)
    other = simulate(parameters, lay.new_state(parameters), -commands, ROW_S, mode)
    np.testing.assert_array_equal(one.x_rad, -other.x_rad)
    np.testing.assert_array_equal(one.tau_Nm, -other.tau_Nm)
    assert np.all(np.abs(one.tau_Nm) <= 9.0)


def test_variants_simulated_together_are_those_simulated_alone() -> None:
    packed = np.array([lay.pack(axis(inertia_kg_m2=j)) for j in (0.03, 0.05, 0.07)])
    commands = 20.0 * np.sin(3.0 * np.arange(500) * ROW_S)
    together = simulate(packed, lay.new_state(packed[0]), commands, ROW_S)
    for parameters, x, tau in zip(packed, together.x_rad, together.tau_Nm, strict=True):
        alone = simulate(parameters, lay.new_state(parameters), commands, ROW_S)
        np.testing.assert_array_equal(x, alone.x_rad)
        np.testing.assert_array_equal(tau, alone.tau_Nm)
    with pytest.raises(ValueError, match="expected a multiple"):
        simulate(packed, lay.new_state(packed[0]), commands, 0.0015)
    with pytest.raises(ValueError, match=r"expected \(n,\) for one"):
        simulate(packed, lay.new_state(packed[0]), commands[:, None], ROW_S)


def test_mean_torque_of_a_cycle_is_what_has_moved_the_shaft() -> None:
    """Torque at SYNC is not the mean torque: set points come with SYNC, and the torque ripples with them."""
    model = axis(coulomb_friction_Nm=0.0, viscous_friction_Nm_s_per_rad=0.0)
    commands = 8.0 * np.sin(6.0 * np.arange(1000) * ROW_S)
    result = simulate(lay.pack(model), lay.new_state(lay.pack(model)), commands, ROW_S)
    np.testing.assert_allclose(result.mean_tau_Nm[1:] * ROW_S, J * np.diff(result.v_rad_s), atol=2e-7)
    between = 0.5 * (result.tau_Nm[1:] + result.tau_Nm[:-1])
    assert np.abs(between - result.mean_tau_Nm[1:])[100:].max() > 0.005
