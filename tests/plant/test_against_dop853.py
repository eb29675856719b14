"""The kernel against scipy's DOP853 on the equations of the design, written down here once more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests import independent
from tests.tiers import slow

from hilbench.plant.motor_port import MotorMode
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import offline
from hilbench.plant.web_line.parameters import load_model

from .models import effect, line_of

ROW_S = 0.002
SMOOTH: list[dict[str, Any]] = [
    effect("viscous_friction", 1, coefficient_N_s_per_m=3.0),
    effect("friction_asymmetry", 2, viscous_difference_N_s_per_m=1.5),
    effect("coulomb_friction", 1, force_N=4.2),
    effect("stribeck_friction", 2, force_N=3.0, speed_m_s=2.5),
    effect("roller_eccentricity", 2, amplitude_m=5e-5, phase_rad=0.3),
    effect("roller_eccentricity", 1, amplitude_m=3e-5, phase_rad=-0.7),
    effect("torque_ripple", 1, amplitude_Nm=0.3, order=2.0, phase_rad=0.4),
    effect("torque_ripple", 1, amplitude_Nm=0.2, order=3.0),
    effect("torque_scale", 2, relative_change=0.07),
    effect("inertia_mismatch", 2, relative_change=0.15),
    effect("elasticity_shift", relative_change=-0.1),
    effect("elasticity_drift", rate_per_s=0.3),
    effect("elasticity_step", time_s=0.1, relative_change=0.2),
    effect("strain_offset", strain=2e-5),
    effect("upstream_disturbance", amplitude_N=3.0, frequency_Hz=4.0, phase_rad=0.2),
    effect("span_length_error", relative_change=0.05),
]
DAMPED = [effect("web_damping", time_constant_s=0.004)]
SLIPPING = [effect("web_slip", creep_per_N=2.2e-5)]


def reference(
    entries: list[dict[str, Any]], axes: int, commands: np.ndarray, v0: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """States [x, v, strain, L, tau] at the rows, and tensions, by DOP853 with segments of one row."""
    given = {(e["effect"], e["axis"]): e["parameters"] for e in entries if e["effect"] != "torque_ripple"}
    ripples = [(e["axis"], e["parameters"]) for e in entries if e["effect"] == "torque_ripple"]

    def of(effect_id: str, name: str, axis: int | None = None) -> float:
        return float(given.get((effect_id, axis), {}).get(name, 0.0))

    n, k = axes, axes - 1
    r = np.array([0.2 - 0.01 * i for i in range(n)])
    ratio = 5.0 / r
    axis_numbers = range(1, n + 1)
    m = np.array([1.167 + 0.1 * i + 25 * 0.001 for i in range(n)]) / r**2
    m = m * (1 + np.array([of("inertia_mismatch", "relative_change", a) for a in axis_numbers]))
    section, e0 = 0.5 * 65e-6, 8.7e9
    strain_prev0 = 80.0 / (e0 * section)
    longer = 1 + of("span_length_error", "relative_change")

    def tensions(t: float, y: np.ndarray, late: bool) -> tuple[np.ndarray, np.ndarray, float, float]:
        x, v, strain, length = y[:n], y[n : 2 * n], y[2 * n : 2 * n + k], y[2 * n + k : 2 * n + 2 * k] * longer
        modulus = e0 * (1 + of("elasticity_shift", "relative_change")) * (1 + of("elasticity_drift", "rate_per_s") * t)
        if late:
            modulus *= 1 + of("elasticity_step", "relative_change")
        wave = of("upstream_disturbance", "amplitude_N") * np.sin(
            2 * np.pi * of("upstream_disturbance", "frequency_Hz") * t + of("upstream_disturbance", "phase_rad")
        )
        strain_prev, f_prev = strain_prev0 + wave / (e0 * section), 80.0 + wave
        a = np.array([of("roller_eccentricity", "amplitude_m", j) for j in axis_numbers])
        phase = np.array([of("roller_eccentricity", "phase_rad", j) for j in axis_numbers])
        surface = v * (1 + a / r * np.cos(x / r + phase))
        c, damping = of("web_slip", "creep_per_N"), of("web_damping", "time_constant_s")
        around = np.concatenate([[strain_prev], strain, [70.0 / (e0 * section)]])
        passing = 1 + np.where(surface >= 0.0, around[:-1], around[1:])  # web has the strain of where it comes from

        def residual(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            behind = np.concatenate([f[1:], [70.0]])
            web = np.concatenate([[surface[0]], surface[1:] - np.abs(surface[1:]) * c * (f - behind)])
            came_in = web[:-1] / passing[:-1] - web[1:] / passing[1:]
            growth = (1 + strain) / length * (rate * longer - (1 + strain) * came_in)
            return modulus * section * (strain - of("strain_offset", "strain") + damping * growth) - f, growth

        # The tensions enter linearly: solve for them.
        base = residual(np.zeros(k))[0]
        matrix = np.column_stack([residual(unit)[0] - base for unit in np.eye(k)])
        f = np.linalg.solve(matrix, -base)
        return f, residual(f)[1], f_prev, modulus

    def derivative(t: float, y: np.ndarray, command: np.ndarray, late: bool) -> np.ndarray:
        x, v, tau = y[:n], y[n : 2 * n], y[2 * n + 2 * k :]
        f, growth, f_prev, _ = tensions(t, y, late)
        around = np.concatenate([[f_prev], f, [70.0]])
        shaft = tau * (1 + np.array([of("torque_scale", "relative_change", a) for a in axis_numbers]))
        for axis, ripple in ripples:
            angle = x[axis - 1] * ratio[axis - 1]
            shaft[axis - 1] += ripple["amplitude_Nm"] * np.sin(ripple["order"] * angle + ripple.get("phase_rad", 0.0))
        resistance = np.zeros(n)
        for i, axis in enumerate(axis_numbers):
            resistance[i] += of("viscous_friction", "coefficient_N_s_per_m", axis) * v[i]
            resistance[i] += of("friction_asymmetry", "viscous_difference_N_s_per_m", axis) * abs(v[i])
            resistance[i] += of("coulomb_friction", "force_N", axis) * np.sign(v[i])
            vs = of("stribeck_friction", "speed_m_s", axis) or 1.0
            resistance[i] += of("stribeck_friction", "force_N", axis) * np.exp(-((v[i] / vs) ** 2)) * np.sign(v[i])
        acceleration = (ratio * shaft + around[1:] - around[:-1] - resistance) / m
        return np.concatenate([v, acceleration, growth, np.full(k, rate), (command - tau) / 0.001])

    y = np.concatenate([np.zeros(n), v0, np.full(k, strain_prev0), [1.0 + 0.2 * j for j in range(k)], np.zeros(n)])
    states, forces = [], []
    step_time = of("elasticity_step", "time_s")
    for row, command in enumerate(commands):
        t = row * ROW_S
        late = t >= step_time - 1e-9
        states.append(y)
        forces.append(tensions(t, y, late)[0])
        solution = solve_ivp(
            derivative, (t, t + ROW_S), y, method="DOP853", rtol=1e-11, atol=1e-14, args=(command, late)
        )
        y = solution.y[:, -1]
    return np.array(states), np.array(forces)


@pytest.mark.parametrize(
    ("axes", "entries", "rate", "start_m_s"),
    [
        (2, [], 0.0, 3.0),
        (2, SMOOTH, 0.0, 3.0),
        (2, SLIPPING, 0.05, 3.0),
        (3, DAMPED, 0.01, 3.0),
        (2, SLIPPING, 0.0, -3.0),
        (3, [], 0.0, 0.02),
        *slow(
            (2, SMOOTH + DAMPED + SLIPPING, 0.0, 3.0),
            (3, SMOOTH + SLIPPING, 0.0, 3.0),
            (5, SMOOTH + DAMPED + SLIPPING, 0.002, 3.0),
            (5, SMOOTH + DAMPED + SLIPPING, 0.002, -3.0),
        ),
    ],
)
def test_kernel_solves_the_equations_of_the_design(
    axes: int, entries: list[dict[str, Any]], rate: float, start_m_s: float
) -> None:
    """Forward, in reverse, and from slowly forward into reverse."""
    rows = 100
    t = np.arange(rows) * ROW_S
    commands = np.column_stack([(1.6 / axes) * np.sin(9.0 * t + i / axes) for i in range(axes)])
    commands -= 0.8 if 0.0 < start_m_s < 1.0 else 0.0
    v0 = np.full(axes, start_m_s)
    states, forces = reference(entries, axes, commands, v0, rate)

    model = line_of(axes, *entries)
    p = lay.pack(model, substeps=4)
    layout = lay.Layout.of(p)
    start = offline.start_state(p, model)
    layout.y(start)[axes : 2 * axes] = layout.y(start)[3 * axes : 4 * axes] = v0
    boundary = np.column_stack([np.full(rows, model.upstream_strain), np.full(rows, 70.0)])
    rates = np.full(axes - 1, rate)
    result = offline.simulate(p, start, commands, boundary, ROW_S, MotorMode.TORQUE, length_rates_m_s=rates)

    n, k = axes, axes - 1
    np.testing.assert_allclose(result.x_m, states[:, :n], rtol=0, atol=2e-9)
    np.testing.assert_allclose(result.v_m_s, states[:, n : 2 * n], rtol=0, atol=2e-8)
    np.testing.assert_allclose(result.strain, states[:, 2 * n : 2 * n + k], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.tau_Nm, states[:, 2 * n + 2 * k :], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.F_N, forces, rtol=0, atol=3e-4)
    assert forces.min() > 0.0  # slack is another test's
    assert np.ptp(forces) > 3.0  # the comparison has something to compare


def test_error_falls_with_the_fourth_power_of_the_step() -> None:
    model = line_of(2)
    rows = 50
    commands = np.column_stack([np.sin(9.0 * ROW_S * np.arange(rows)), np.zeros(rows)])
    states, _ = reference([], 2, commands, np.zeros(2), 0.0)
    boundary = np.column_stack([np.full(rows, model.upstream_strain), np.full(rows, 70.0)])
    errors = []
    for substeps in (1, 2, 4):
        p = lay.pack(model, substeps)
        result = offline.simulate(p, offline.start_state(p, model), commands, boundary, ROW_S, MotorMode.TORQUE)
        errors.append(np.abs(result.strain[:, 0] - states[:, 4]).max())
    assert errors[0] / errors[1] > 12.0
    assert errors[1] / errors[2] > 12.0


@pytest.mark.parametrize("name", ["web_slip", "nominal", "elasticity_shift", "coulomb_friction", "roller_eccentricity"])
def test_recording_of_an_independent_simulator_is_met_within_its_noise(name: str) -> None:
    model = load_model(independent.MODEL).with_effects(*independent.hidden_in(name))
    data = np.genfromtxt(independent.recording(name), delimiter=",", names=True, max_rows=12_000)
    p = lay.pack(model)
    commands = np.column_stack([data["v1_cmd_m_s"], data["v2_cmd_m_s"]])
    boundary = np.column_stack([data["strain_prev"], data["F_next_N"]])
    result = offline.simulate(p, offline.start_state(p, model), commands, boundary, ROW_S)
    sticks = name == "coulomb_friction"  # at standstill that simulator's friction fades out, and ours holds
    rows = slice(1500 if sticks else 0, None)
    for i in (0, 1):
        torque = (data[f"tau{i + 1}_Nm"] - result.tau_Nm[:, i])[rows]
        smooth = np.convolve(torque, np.ones(50) / 50, "valid")
        assert np.std(torque) < 1.02 * 0.05
        assert np.abs(smooth).max() < 5 * 0.05 / np.sqrt(50)
        assert np.abs(data[f"x{i + 1}_m"] - result.x_m[:, i]).max() < (2e-4 if sticks else 5e-6)
