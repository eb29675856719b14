"""The closed line, the web on measured motion, and the published operating point."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower

from .cycles import follow
from .models import effect, line_of, lone_axis, model

STIFFNESS_N = 8.7e9 * 0.5 * 65e-6
STRAIN_PREV = 80.0 / STIFFNESS_N
RAD_PER_M = 25.0


def running(v1: float, v2: float = 3.0, **changes: object) -> tuple[Line, list[MotorPort]]:
    """A line at speed, its drives' integrals settled."""
    ports = [MotorPort(mode=MotorMode.VELOCITY) for _ in range(2)]
    line = Line(model(**changes), ports)  # type: ignore[arg-type]
    line.set_state({"v1_m_s": v1, "v2_m_s": v2})
    ports[0].setpoint, ports[1].setpoint = v1 * RAD_PER_M, v2 * RAD_PER_M
    line.step(100.0)
    return line, ports


def test_steady_state_after_the_step_of_the_modulus() -> None:
    # The published step: at 80 N the web is strained less by the stiffer paper, so roller 1 must run faster.
    strain = 80.0 / (STIFFNESS_N * 10.5 / 8.7)
    v1 = 3.0 * (1 + STRAIN_PREV) / (1 + strain)
    assert v1 == pytest.approx(3.000145, abs=1e-6)
    line, ports = running(v1)
    line.set_parameter("youngs_modulus_Pa", 10.5e9)
    line.step(400.0)
    before = line.tension_N[0]
    line.step(1.0)
    assert line.tension_N[0] == pytest.approx(80.0, abs=1e-4)
    assert line.tension_N[0] == pytest.approx(before, abs=1e-6)
    assert ports[1].torque_Nm == pytest.approx((80.0 - 70.0) / RAD_PER_M, abs=1e-5)


def test_step_of_the_modulus_moves_the_tension_and_not_the_strain() -> None:
    line, _ = running(3.0)
    strain = line.strain.copy()
    line.set_parameter("youngs_modulus_Pa", 10.5e9)
    assert np.array_equal(line.strain, strain)
    assert line.tension_N[0] == pytest.approx(80.0 * 10.5 / 8.7, abs=1e-3)


def test_axis_without_web_load_feels_no_tension() -> None:
    line, ports = running(3.0, web_load=[False, True])
    line.set_input("strain_prev", STRAIN_PREV * 1.5)
    line.step(2.0)
    assert abs(ports[0].torque_Nm) < 1e-6
    assert ports[1].torque_Nm > 0.5


def test_slack_web_does_not_push() -> None:
    line, _ = running(3.01)
    assert line.strain[0] < 0.0
    assert line.tension_N[0] == 0.0


def test_effects_come_and_go_at_run_time() -> None:
    line, ports = running(3.0)
    line.set_effect("coulomb_friction", 2, force_N=5.0)
    line.step(4.0)
    assert ports[1].torque_Nm - (line.tension_N[0] - 70.0) / RAD_PER_M == pytest.approx(5.0 / RAD_PER_M, abs=1e-6)
    line.clear_effect("coulomb_friction", 2)
    line.step(4.0)
    assert ports[1].torque_Nm == pytest.approx((line.tension_N[0] - 70.0) / RAD_PER_M, abs=1e-6)


def test_span_length_error_at_run_time_leaves_the_strain() -> None:
    line, _ = running(3.0)
    strain = line.strain[0]
    line.set_effect("span_length_error", relative_change=0.1)
    assert line.strain[0] == pytest.approx(strain, abs=1e-14)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("coulomb_friction", 3, {"force_N": 1.0}), "axis 3, expected 1 to 2"),
        (("coulomb_friction", None, {"force_N": 1.0}), "lacks its axis"),
        (("web_slip", 1, {"creep_per_N": 1e-6}), "effect of the web"),
        (("coulomb_friction", 1, {"force": 1.0}), "no parameter 'force'"),
        (("torque_delay", 1, {"delay_s": 1.0}), "expected 0 to 0.05"),
    ],
)
def test_wrong_effects_are_refused_and_change_nothing(
    arguments: tuple[str, int | None, dict[str, float]], text: str
) -> None:
    line, _ = running(3.0)
    other, _ = running(3.0)
    effect_id, axis, parameters = arguments
    with pytest.raises(ValueError, match=text):
        line.set_effect(effect_id, axis, **parameters)
    line.step(0.1)
    other.step(0.1)
    assert line.outputs() == other.outputs()


def test_duration_must_be_whole_samples() -> None:
    line, _ = running(3.0)
    with pytest.raises(ValueError, match="multiple of the drives' sample time"):
        line.step(0.0015)


def test_line_of_five_finds_its_steady_strains() -> None:
    ports = [MotorPort(mode=MotorMode.VELOCITY) for _ in range(5)]
    line = Line(line_of(5), ports)
    speeds = 2.0 * (1 + 1e-5 * np.array([0.0, 2.0, 1.0, 3.0, 4.0]))
    line.set_state({f"v{k}_m_s": speed for k, speed in enumerate(speeds, 1)})
    for port, v, radius in zip(ports, speeds, line.parameters.rollers.radius_m, strict=True):  # type: ignore[arg-type]
        port.setpoint = v * 5.0 / radius
    line.step(200.0)
    expected = (1 + STRAIN_PREV) * speeds[1:] / speeds[0] - 1
    np.testing.assert_allclose(line.strain, expected, atol=1e-10)


def test_motor_modes_of_a_port() -> None:
    port = MotorPort(mode=MotorMode.VELOCITY, setpoint=2.0, slope=10.0)
    line = Line(lone_axis(), [port])
    line.step(0.1)
    assert port.reference == pytest.approx(1.0)
    line.step(60.0)
    assert port.velocity_rad_s == pytest.approx(2.0, abs=1e-3)
    port.mode, port.setpoint, port.slope = MotorMode.TORQUE, 0.5, np.inf
    port.torque_limit_Nm = 0.2
    line.step(0.1)
    assert port.torque_Nm == pytest.approx(0.2)
    assert port.torque_limited
    port.mode = MotorMode.OFF
    v = port.velocity_rad_s
    line.step(0.1)
    assert port.torque_Nm == 0.0
    assert port.velocity_rad_s == v
    assert not port.torque_limited


def test_position_mode_follows_a_ramp_without_lag_and_holds() -> None:
    drives = {
        "velocity_kp_Nm_s_per_rad": 300.0,
        "velocity_ki_Nm_per_rad": 3000.0,
        "position_kp_per_s": 20.0,
        "torque_limit_Nm": 1000.0,
    }
    port = MotorPort(mode=MotorMode.POSITION, setpoint=3.0, slope=1.0)
    line = Line(lone_axis().model_copy(update={"drives": type(model().drives).model_validate(drives)}), [port])
    line.step(2.0)
    assert port.position_rad == pytest.approx(port.reference, abs=2e-3)
    line.step(5.0)
    assert port.position_rad == pytest.approx(3.0, abs=1e-6)


def test_follower_is_exact_for_constant_speeds() -> None:
    # Unstretched length w' = v1/(1 + strain_prev) - v2·w/L: an exponential.
    v1, v2, t = 2.9, 3.1, 0.05
    follower = LineFollower(model())
    follower.follow([v1 * t, v2 * t], t)
    rest = v1 / (1 + STRAIN_PREV) / v2
    w = rest + (1 / (1 + STRAIN_PREV) - rest) * np.exp(-v2 * t)
    assert follower.strain[0] == pytest.approx(1 / w - 1, abs=1e-13)


def test_follower_and_recorded_form_agree_and_find_the_lines_tension() -> None:
    entries = (
        effect("roller_eccentricity", 2, amplitude_m=3e-5, phase_rad=0.3),
        effect("web_slip", creep_per_N=2e-6),
        effect("elasticity_step", time_s=0.5, relative_change=0.1),
        effect("upstream_disturbance", amplitude_N=2.0, frequency_Hz=3.0),
    )
    ports = [MotorPort(mode=MotorMode.VELOCITY, setpoint=RAD_PER_M) for _ in range(2)]
    line = Line(model(*entries), ports)
    line.set_state({"v1_m_s": 1.0, "v2_m_s": 1.0})
    rows = 500
    x, tension = [line.x_m], [line.tension_N[0]]
    for _ in range(rows - 1):
        line.step(0.002)
        x.append(line.x_m)
        tension.append(line.tension_N[0])
    boundary = np.tile([STRAIN_PREV, 70.0], (rows, 1))
    found = follow(model(*entries), np.array(x), boundary, 0.002)[:, 0]
    one_by_one = LineFollower(model(*entries))
    again = [one_by_one.tension_N[0]]
    for row in x[1:]:
        one_by_one.follow(row, 0.002)
        again.append(one_by_one.tension_N[0])
    np.testing.assert_allclose(found, again, atol=1e-9)
    assert np.ptp(tension) > 5.0
    # Within a cycle the speeds are not constant: the rest is what that assumption costs.
    np.testing.assert_allclose(found, tension, atol=2e-3)


def test_prediction_is_what_comes_when_the_speeds_stay() -> None:
    follower, other = LineFollower(model()), LineFollower(model())
    for each in (follower, other):
        each.follow([0.0060, 0.00602], 0.002)
    predicted = follower.predicted_tension_N(0.004)
    other.follow([0.0180, 0.01806], 0.004)
    assert predicted[0] == pytest.approx(other.tension_N[0], abs=1e-9)
    assert follower.tension_N[0] != predicted[0]


def test_web_torque_holds_tension_difference_and_emulated_friction() -> None:
    follower = LineFollower(model(web_load=[False, True]))
    assert follower.web_torque_Nm(1, 3.0) == 0.0
    assert follower.web_torque_Nm(2, 3.0) == pytest.approx((70.0 - 80.0) / RAD_PER_M)
    follower.set_effect("coulomb_friction", 2, force_N=4.0)
    follower.set_effect("viscous_friction", 2, coefficient_N_s_per_m=2.0)
    assert follower.web_torque_Nm(2, 3.0) == pytest.approx((70.0 - 80.0 - 4.0 - 6.0) / RAD_PER_M)
    assert follower.web_torque_Nm(2, 0.0) == pytest.approx((70.0 - 80.0) / RAD_PER_M)
    both = LineFollower(model())
    assert both.web_torque_Nm(1, 3.0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("axis", [1, 2, 3, 4])
def test_any_roller_feels_the_difference_of_the_spans_around_it_and_its_own_friction(axis: int) -> None:
    follower = LineFollower(line_of(4))
    follower.set_effect("viscous_friction", axis, coefficient_N_s_per_m=2.0)
    follower.set_input("F_next_N", 64.0)
    for k in range(1, 200):  # the rollers run apart by more and more: every span has a tension of its own
        follower.follow([0.004 * k * (1.0 + 2e-6 * i * i) for i in range(4)], 0.002)
    around = [STRAIN_PREV * STIFFNESS_N, *follower.tension_N, 64.0]
    assert np.abs(np.diff(around)).min() > 0.1
    rad_per_m = 5.0 / (0.2 - 0.01 * (axis - 1))
    expected = (around[axis] - around[axis - 1] - 2.0 * 1.5) / rad_per_m
    assert follower.web_torque_Nm(axis, 1.5) == pytest.approx(expected, rel=1e-9)


def test_load_motors_of_several_rollers_get_the_tensions_of_one_later_instant() -> None:
    follower, later = LineFollower(line_of(4)), LineFollower(line_of(4))
    way = 0.004 * (1.0 + 2e-6 * np.arange(4) ** 2)
    for each in (follower, later):
        each.follow(way, 0.002)
    later.follow(3.0 * way, 0.004)
    speeds = [1.0, 2.0, 3.0, 4.0]
    torques = follower.load_torques_Nm([2, 4], speeds, 0.004)
    assert torques == pytest.approx([later.web_torque_Nm(2, 2.0), later.web_torque_Nm(4, 4.0)], abs=1e-9)
    assert torques != pytest.approx([follower.web_torque_Nm(2, 2.0), follower.web_torque_Nm(4, 4.0)], abs=1e-6)


def test_web_that_has_torn_pulls_no_more_until_it_is_whole_again() -> None:
    follower = LineFollower(model(web_load=[False, True]))
    whole = follower.outputs()
    follower.set_parameter("broken", 1.0)
    assert follower.outputs() == {**whole, "F1_N": 0.0, "strain1": 0.0}
    assert follower.load_torques_Nm([2], [0.0, 3.0], 0.004) == [70.0 / RAD_PER_M]
    follower.set_parameter("broken", 0.0)
    assert follower.outputs() == whole


def test_effect_that_no_torque_can_emulate_is_refused() -> None:
    follower = LineFollower(model())
    with pytest.raises(ValueError, match="effect 'backlash' here, expected one of coulomb_friction"):
        follower.set_effect("backlash", 2, gap_rad=0.01)
