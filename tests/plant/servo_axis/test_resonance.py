"""A part of the inertia behind a shaft that twists: against scipy on the two masses as written, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hilbench.compiled import Vector
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.offline import Simulation, simulate
from hilbench.plant.web_line.inverse import required_torque_Nm

from .models import axis, effect

ROW_S = 0.001
J, B = 0.048, 0.004
SHARE, FREQUENCY_HZ, DAMPING = 0.35, 27.0, 0.04
SWING = effect("resonance", SHARE, FREQUENCY_HZ, DAMPING)
#: What is behind the shaft, its stiffness and damping, as a textbook has them.
J_2 = SHARE * J
OMEGA = 2.0 * np.pi * FREQUENCY_HZ
K, D = J_2 * OMEGA**2, 2.0 * DAMPING * OMEGA * J_2


def free(**changes: float) -> Vector:
    """An axis whose motor's torque is there at once."""
    return lay.pack(axis(SWING, drives={"current_loop_time_constant_s": 0.0}, **changes), substeps=4)


def driven(parameters: Vector, torque_Nm: Vector) -> Simulation:
    return simulate(parameters, lay.new_state(parameters), torque_Nm, ROW_S, MotorMode.TORQUE)


def test_motor_and_load_swing_against_each_other_as_two_masses() -> None:
    torque = np.random.default_rng(0).uniform(-2.0, 2.0, 400)
    found = driven(free(coulomb_friction_Nm=0.0), torque)
    y, states = np.zeros(4), []
    for command in torque:
        states.append(y)

        def rates(_: float, y: np.ndarray, command: float = command) -> list[float]:
            x, v, x_2, v_2 = y
            shaft = K * (x - x_2) + D * (v - v_2)
            return [v, (command - B * v - shaft) / (J - J_2), v_2, shaft / J_2]

        y = solve_ivp(rates, (0.0, ROW_S), y, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    x, v, _, _ = np.array(states).T
    np.testing.assert_allclose(found.x_rad, x, atol=1e-8)
    np.testing.assert_allclose(found.v_rad_s, v, atol=1e-6)


@pytest.mark.parametrize("at", ["antiresonance", "resonance"])
def test_the_motor_hardly_moves_at_the_antiresonance_and_most_at_the_resonance(at: str) -> None:
    frequency = FREQUENCY_HZ if at == "antiresonance" else FREQUENCY_HZ / np.sqrt(1.0 - SHARE)

    def speed(frequency_Hz: float) -> float:
        phase = 2.0 * np.pi * frequency_Hz * ROW_S * np.arange(3000)
        moved = driven(free(coulomb_friction_Nm=0.0), np.sin(phase)).v_rad_s[1500:]
        return 2.0 * float(abs(np.mean(moved * np.exp(-1j * phase[1500:])))) * 2.0 * np.pi * frequency_Hz * J

    # Of a stiff shaft it would be 1 at any frequency.
    assert speed(frequency) < 0.3 if at == "antiresonance" else speed(frequency) > 3.0


def test_what_is_behind_a_shaft_that_sticks_swings_on() -> None:
    parameters = free(coulomb_friction_Nm=50.0)
    start, twist = lay.new_state(parameters), 0.01
    start[lay.S_X_BEHIND] = twist
    damped = OMEGA * np.sqrt(1.0 - DAMPING**2)
    for rows in (7, 20, 60):
        found = simulate(parameters, start, np.zeros(rows), ROW_S, MotorMode.TORQUE)
        t = rows * ROW_S
        swing = np.cos(damped * t) + DAMPING / np.sqrt(1.0 - DAMPING**2) * np.sin(damped * t)
        assert found.state[lay.S_X_BEHIND] == pytest.approx(twist * np.exp(-DAMPING * OMEGA * t) * swing, abs=1e-8)
        assert found.state[lay.S_X] == found.state[lay.S_V] == 0.0


def test_a_twist_that_pulls_more_than_dry_friction_holds_turns_the_motor() -> None:
    twist = 0.01
    for friction, turns in ((1.05 * K * twist, False), (0.95 * K * twist, True)):
        parameters = free(coulomb_friction_Nm=friction)
        start = lay.new_state(parameters)
        start[lay.S_X_BEHIND] = twist
        found = simulate(parameters, start, np.zeros(3), ROW_S, MotorMode.TORQUE)
        assert (found.x_rad[-1] > 0.0) == turns


def test_the_torque_that_a_measured_motion_needs_is_the_one_that_made_it() -> None:
    t = ROW_S * np.arange(4000)
    torque = 1.5 * np.sin(2.0 * np.pi * (2.0 * t + 4.0 * t**2))  # 2 to 34 Hz, through both
    parameters = free(coulomb_friction_Nm=0.0)
    found, out = driven(parameters, torque), np.empty(len(t))
    acceleration = np.gradient(found.v_rad_s, ROW_S)
    required_torque_Nm(parameters, found.x_rad, found.v_rad_s, acceleration, ROW_S, out)
    both = 0.5 * (torque[1:-2] + torque[2:-1])  # a central difference is the mean of two rows' accelerations
    np.testing.assert_allclose(out[2:-1], both, atol=0.15)
    stiff = lay.pack(axis(coulomb_friction_Nm=0.0))
    required_torque_Nm(stiff, found.x_rad, found.v_rad_s, acceleration, ROW_S, out)
    assert np.max(np.abs(out[2:-1] - both)) > 1.0
