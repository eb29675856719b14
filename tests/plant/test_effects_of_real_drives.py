"""Effects that the axes of stands have beside friction: each against the equation it is, solved by scipy or by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hilbench.plant.motor_laws import measured_motion
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.servo_axis import layout as servo_lay
from hilbench.plant.servo_axis import offline as servo_offline
from hilbench.plant.web_line import laws, offline
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters

from .models import DEMONSTRATOR, effect, lone_axis, model
from .servo_axis.models import axis as servo_model

ROW_S = 0.002
T_S = np.arange(800) * ROW_S
TORQUE_NM = 4.0 * np.sin(3.0 * T_S)
#: Of the lone axis: 3 kg at the web, a metre a radian.
MASS_KG = 3.0


def driven(*effects: dict[str, Any], torque: np.ndarray = TORQUE_NM, v0: float = 0.0) -> offline.Simulation:
    """The lone axis under a torque."""
    parameters = lone_axis(*effects)
    p = lay.pack(parameters, substeps=4)
    layout = lay.Layout.of(p)
    start = offline.start_state(p, parameters)
    layout.y(start)[1] = layout.y(start)[3] = v0
    lay.refresh_modes(p, start)
    return offline.simulate(p, start, torque[:, None], np.zeros((len(torque), 2)), ROW_S, MotorMode.TORQUE)


def turned(*effects: dict[str, Any], torque: np.ndarray = TORQUE_NM, v0: float = 0.0) -> servo_offline.Simulation:
    """The same as a servo axis."""
    parameters = servo_model(*effects, **SHAFT)
    p = servo_lay.pack(parameters, substeps=4)
    start = servo_lay.new_state(p, v_rad_s=v0)
    return servo_offline.simulate(p, start, torque, ROW_S, MotorMode.TORQUE)


#: With the motor's 0.001 kg·m² 3 kg·m² in all, a drive whose torque is there at once, and no friction.
SHAFT: dict[str, Any] = {
    "inertia_kg_m2": 2.999,
    "coulomb_friction_Nm": 0.0,
    "viscous_friction_Nm_s_per_rad": 0.0,
    "drives": {"torque_limit_Nm": 1000.0, "current_loop_time_constant_s": 0.0},
}


def solved(resistance: Any, torque: np.ndarray = TORQUE_NM, v0: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """x and v of 3·v' = τ - R(x, v, τ) by DOP853, the torque held from row to row."""
    y, found = np.array([0.0, v0]), []
    for row, value in enumerate(torque):
        found.append(y)
        t = row * ROW_S

        def rates(_: float, y: np.ndarray, value: float = value) -> list[float]:
            return [y[1], (value - resistance(y[0], y[1], value)) / MASS_KG]

        y = solve_ivp(rates, (t, t + ROW_S), y, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return np.array(found)[:, 0], np.array(found)[:, 1]


def test_drag_grows_with_the_square_of_the_speed() -> None:
    x, v = solved(lambda x, v, tau: 0.4 * v * abs(v))
    line = driven(effect("quadratic_drag", 1, coefficient_N_s2_per_m2=0.4))
    shaft = turned(effect("quadratic_drag", 1, coefficient_Nm_s2_per_rad2=0.4))
    assert np.ptp(v) > 0.5
    for found_x, found_v in ((line.x_m[:, 0], line.v_m_s[:, 0]), (shaft.x_rad, shaft.v_rad_s)):
        np.testing.assert_allclose(found_x, x, atol=1e-8)
        np.testing.assert_allclose(found_v, v, atol=1e-8)


def test_friction_of_a_load_takes_its_share_of_what_the_motor_pushes_with() -> None:
    """Forward all the time, so that the sign is no question: driven by (1 - k)·τ, braked by (1 + k)·|τ|."""
    _, v = solved(lambda x, v, tau: 0.2 * abs(tau) * np.sign(v), v0=3.0)
    share = effect("load_dependent_friction", 1, share=0.2)
    assert v.min() > 0.5
    for found in (driven(share, v0=3.0).v_m_s[:, 0], turned(share, v0=3.0).v_rad_s):
        np.testing.assert_allclose(found, v, atol=1e-9)


def test_an_axis_under_load_turns_over_as_often_as_the_torque_and_never_sticks_for_good() -> None:
    """A share of the torque never holds all of it: at a speed of zero the axis turns on at once."""
    share = effect("load_dependent_friction", 1, share=0.3)
    for found in (driven(share).v_m_s[:, 0], turned(share).v_rad_s):
        plain = driven().v_m_s[:, 0]
        assert 0.5 * np.ptp(plain) < np.ptp(found) < np.ptp(plain)
    stood = driven(share, torque=np.full(400, 2.0)).v_m_s[:, 0]
    np.testing.assert_allclose(stood, 2.0 * 0.7 / MASS_KG * T_S[:400], atol=1e-9)


def test_coulomb_friction_and_that_of_a_load_hold_together() -> None:
    held = effect("coulomb_friction", 1, force_N=2.0), effect("load_dependent_friction", 1, share=0.5)
    assert np.all(driven(*held, torque=np.full(200, 3.99)).x_m == 0.0)
    assert driven(*held, torque=np.full(200, 4.1)).v_m_s[-1, 0] > 0.0


def test_ripple_in_proportion_to_the_torque() -> None:
    _, v = solved(lambda x, v, tau: -tau * 0.3 * np.sin(2.0 * x + 0.5))
    ripple = effect("torque_ripple_load", 1, relative_amplitude=0.3, order=2.0, phase_rad=0.5)
    for found in (driven(ripple).v_m_s[:, 0], turned(ripple).v_rad_s):
        np.testing.assert_allclose(found, v, atol=1e-8)
    assert np.all(driven(ripple, torque=np.zeros(100)).x_m == 0.0)


FED = {"inertia_share": 0.8, "viscous_share": 0.5, "coulomb_share": 0.25}


def test_what_is_fed_forward_is_missing_from_the_torque_and_moves_nothing() -> None:
    frictions = (
        effect("viscous_friction", 1, coefficient_N_s_per_m=1.5),
        effect("coulomb_friction", 1, force_N=0.5),
        effect("inertia_mismatch", 1, relative_change=0.1),
    )
    plain, fed = driven(*frictions), driven(*frictions, effect("feed_forward", 1, **FED))
    assert np.array_equal(plain.v_m_s, fed.v_m_s)
    v = plain.v_m_s[:, 0]
    a = (plain.tau_Nm[:, 0] - 1.5 * v - 0.5 * np.sign(v)) / 3.3
    left_out = 0.8 * 3.3 * a + 0.5 * 1.5 * v + 0.25 * 0.5 * np.sign(v)
    rows = np.abs(v) > 1e-3
    np.testing.assert_allclose((plain.tau_Nm - fed.tau_Nm)[rows, 0], left_out[rows], atol=1e-9)


def test_what_is_fed_forward_on_a_servo_axis_is_missing_as_well_and_from_the_mean() -> None:
    shaft = {**SHAFT, "viscous_friction_Nm_s_per_rad": 1.5, "coulomb_friction_Nm": 0.5}
    found = []
    for entries in ((), (effect("feed_forward", 1, **FED),)):
        p = servo_lay.pack(servo_model(*entries, **shaft), substeps=4)
        found.append(servo_offline.simulate(p, servo_lay.new_state(p), TORQUE_NM, ROW_S, MotorMode.TORQUE))
    plain, fed = found
    assert np.array_equal(plain.v_rad_s, fed.v_rad_s)
    v = plain.v_rad_s
    a = (plain.tau_Nm - 1.5 * v - 0.5 * np.sign(v)) / 3.0
    left_out = 0.8 * 3.0 * a + 0.5 * 1.5 * v + 0.25 * 0.5 * np.sign(v)
    rows = np.abs(v) > 0.01
    np.testing.assert_allclose((plain.tau_Nm - fed.tau_Nm)[rows], left_out[rows], atol=1e-9)
    np.testing.assert_allclose((plain.mean_tau_Nm - fed.mean_tau_Nm)[rows], left_out[rows], atol=0.02)


def test_a_late_torque_lacks_what_was_fed_forward_when_it_acted() -> None:
    fed, late = effect("feed_forward", 1, inertia_share=0.8), effect("torque_delay", 1, delay_s=0.004)
    for run in (lambda *e: driven(*e).tau_Nm[:, 0], lambda *e: turned(*e).tau_Nm):
        np.testing.assert_allclose(run(fed, late)[10:], run(fed)[8:-2], atol=1e-12)


def test_an_encoder_that_errs_once_a_turn_shows_it_in_angle_and_speed_of_a_free_axis() -> None:
    error = effect("encoder_error", 1, amplitude_rad=0.05, phase_rad=0.3)
    plain, erring = driven(v0=2.0), driven(error, v0=2.0)
    x, v = plain.x_m[:, 0], plain.v_m_s[:, 0]
    np.testing.assert_allclose(erring.x_m[:, 0], x + 0.05 * np.sin(x + 0.3), atol=1e-12)
    np.testing.assert_allclose(erring.v_m_s[:, 0], v * (1.0 + 0.05 * np.cos(x + 0.3)), atol=1e-12)
    assert np.array_equal(plain.tau_Nm, erring.tau_Nm)
    shaft = turned(error, v0=2.0)
    np.testing.assert_allclose(shaft.x_rad, x + 0.05 * np.sin(x + 0.3), atol=1e-8)


def test_the_velocity_loop_follows_an_encoder_that_errs() -> None:
    """At constant measured speed the true one swings: the drive believes its encoder."""
    parameters = lone_axis(effect("encoder_error", 1, amplitude_rad=0.05))
    p = lay.pack(parameters)
    motor = lay.Layout.of(p).motor_rows(p)[0]
    motor.kp, motor.ki = 300.0, 3000.0
    commands = np.full((3000, 1), 4.0)
    result = offline.simulate(p, offline.start_state(p, parameters), commands, np.zeros((3000, 2)), ROW_S)
    torque = result.tau_Nm[1000:, 0]
    assert np.ptp(torque) > 0.05 * MASS_KG * 4.0**2  # m·a of the true motion, a = A·ω²
    assert np.ptp(result.v_m_s[1000:, 0]) < 0.05 * 4.0 * 2.0


def test_gains_and_lag_of_a_drive_are_those_of_a_model_that_has_them() -> None:
    drives = {
        **DEMONSTRATOR["drives"],
        "velocity_kp_Nm_s_per_rad": [1.5, 1.5 * 1.2],
        "velocity_ki_Nm_per_rad": [30.0, 30.0 * 0.7],
        "current_loop_time_constant_s": [0.001, 0.004],
    }
    changed = model(
        effect("drive_gain", 2, kp_relative_change=0.2, ki_relative_change=-0.3), effect("drive_lag", 2, lag_s=0.003)
    )
    commands = np.column_stack([np.sin(8.0 * T_S), np.sin(8.0 * T_S + 1e-4)])
    found = []
    for parameters in (changed, model(drives=drives), model()):
        p = lay.pack(parameters)
        boundary = np.tile([parameters.upstream_strain, 70.0], (len(T_S), 1))
        found.append(offline.simulate(p, offline.start_state(p, parameters), commands, boundary, ROW_S))
    np.testing.assert_allclose(found[0].tau_Nm, found[1].tau_Nm, atol=1e-9)
    assert np.abs(found[0].tau_Nm - found[2].tau_Nm).max() > 0.1


def test_a_current_loop_is_never_faster_than_at_once() -> None:
    def time_constant_s(lag_s: float) -> float:
        p = lay.pack(model(effect("drive_lag", 2, lag_s=lag_s)))
        return float(laws.current_loop_s(lay.Layout.of(p).motor_rows(p)[1]))

    assert time_constant_s(-0.0004) == pytest.approx(0.0006)
    assert time_constant_s(-0.05) == 0.0


@settings(max_examples=40, deadline=None)
@given(
    share=st.just(0.0) | st.floats(1e-6, 0.6),
    drag=st.just(0.0) | st.floats(1e-6, 1.0),
    ripple=st.just(0.0) | st.floats(1e-6, 0.4),
    inertia_share=st.just(0.0) | st.floats(1e-6, 1.2),
    amplitude=st.just(0.0) | st.floats(1e-6, 0.2),
    phase=st.just(0.0) | st.floats(0.01, 3.0),
)
def test_the_torque_that_a_measured_motion_needs_is_the_one_that_made_it(
    share: float, drag: float, ripple: float, inertia_share: float, amplitude: float, phase: float
) -> None:
    """Forward simulation and inverse dynamics are the same laws, whatever an axis has of them."""
    made = (
        effect("load_dependent_friction", 1, share=share),
        effect("quadratic_drag", 1, coefficient_N_s2_per_m2=drag),
        effect("torque_ripple_load", 1, relative_amplitude=ripple, order=3.0, phase_rad=phase),
        effect("feed_forward", 1, inertia_share=inertia_share),
        effect("encoder_error", 1, amplitude_rad=amplitude, phase_rad=phase),
        effect("viscous_friction", 1, coefficient_N_s_per_m=0.7),
    )
    parameters = lone_axis(*made)
    p = lay.pack(parameters)
    rng = np.random.default_rng(0)
    x, v, tau = rng.uniform(-5.0, 5.0, 50), rng.uniform(0.1, 4.0, 50), rng.uniform(-5.0, 5.0, 50)
    v *= rng.choice([-1.0, 1.0], 50)
    shaft = tau * (1.0 + ripple * np.sin(3.0 * x + phase))
    a = (shaft - 0.7 * v - drag * v * np.abs(v) - share * np.abs(shaft) * np.sign(v)) / MASS_KG
    measured_x, measured_v = x + amplitude * np.sin(x + phase), v * (1.0 + amplitude * np.cos(x + phase))
    measured_a = a * (1.0 + amplitude * np.cos(x + phase)) - amplitude * np.sin(x + phase) * v**2
    for k in range(len(x)):
        out = np.empty(2)
        motion = (np.full(2, value[k]) for value in (measured_x, measured_v, measured_a))
        required_torque_Nm(p, *motion, 0.001, out)
        assert out[0] == pytest.approx(tau[k] - inertia_share * MASS_KG * a[k], abs=1e-9)
    assert measured_motion(amplitude, phase, float(x[0]), float(v[0])) == pytest.approx((measured_x[0], measured_v[0]))


def test_effects_of_real_drives_run_on_a_whole_line_and_end_where_they_are_cleared() -> None:
    line, plain = Line(model()), Line(model())
    for effect_id, values in (
        ("load_dependent_friction", {"share": 0.1}),
        ("quadratic_drag", {"coefficient_N_s2_per_m2": 0.2}),
        ("encoder_error", {"amplitude_rad": 0.01}),
        ("drive_gain", {"kp_relative_change": 0.3}),
    ):
        line.set_effect(effect_id, 2, **values)
        line.clear_effect(effect_id, 2)
    line.step(0.1)
    plain.step(0.1)
    assert line.outputs() == plain.outputs()


def test_a_share_may_be_given_alone() -> None:
    found = ModelParameters.model_validate(
        {**DEMONSTRATOR, "effects": [effect("feed_forward", 1, inertia_share=0.9)]}
    ).effects[0]
    assert found.parameters == {"inertia_share": 0.9}
