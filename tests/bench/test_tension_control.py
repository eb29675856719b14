"""The tension controller on the span's own differential equation, written out here."""

import math
from typing import Any

import numpy as np
import pytest

from hilbench.compiled import record_at
from hilbench.control.web_line.tension import CONTROLLER, control, gains_at
from hilbench.topology.web_line_config import TensionControlConfig

STIFFNESS_N = 8.7e9 * 0.5 * 65e-6
LENGTH_M = 1.0
STRAIN_PREV, STRAIN_NEXT = 80.0 / STIFFNESS_N, 70.0 / STIFFNESS_N
CYCLE_S = 0.002


def controller_of(config: TensionControlConfig, roller_stiffness_N_per_m: float = math.inf) -> Any:
    c = record_at(np.zeros(CONTROLLER.itemsize // 8), CONTROLLER)
    c.bandwidth_rad_per_s, c.limit_m_s = config.bandwidth_rad_per_s, config.correction_limit_m_s
    c.length_m, c.section_m2, c.roller_N_per_m = LENGTH_M, 0.5 * 65e-6, roller_stiffness_N_per_m
    c.upstream_strain, c.downstream_strain = STRAIN_PREV, STRAIN_NEXT
    return c


def velocity(controller: Any, line_m_s: float, set_point_N: float, tension_N: float) -> float:
    """A cycle of the closed loop."""
    return control(controller, True, line_m_s, set_point_N, tension_N, 8.7e9, CYCLE_S, math.nan)


def hold(controller: Any, line_m_s: float, set_point_N: float) -> float:
    """A cycle of the open loop."""
    return control(controller, False, line_m_s, set_point_N, 0.0, 0.0, CYCLE_S, math.nan)


def run(speed_m_s: float, set_point_N: float, duration_s: float, bandwidth: float = 3.0) -> list[float]:
    controller = controller_of(TensionControlConfig(bandwidth_rad_per_s=bandwidth))
    strain, tensions = STRAIN_PREV, []
    for _ in range(round(duration_s / CYCLE_S)):
        tension_N = STIFFNESS_N * strain
        v1 = velocity(controller, speed_m_s, set_point_N, tension_N)
        came_in = v1 / (1 + STRAIN_PREV) - speed_m_s / (1 + strain)
        if speed_m_s < 0.0:
            came_in = v1 / (1 + strain) - speed_m_s / (1 + STRAIN_NEXT)
        strain -= CYCLE_S * (1 + strain) ** 2 / LENGTH_M * came_in
        tensions.append(tension_N)
    return tensions


@pytest.mark.parametrize("speed_m_s", [1.0, 3.0, 8.0])
def test_the_loop_is_first_order_with_the_wanted_bandwidth_where_the_span_is_fast(speed_m_s):
    tensions = run(speed_m_s, 95.0, 3.0)
    for time_s in (0.1, 0.3, 1.0):
        expected = 95.0 - 15.0 * math.exp(-3.0 * time_s)
        assert tensions[round(time_s / CYCLE_S)] == pytest.approx(expected, abs=0.3)
    assert tensions[-1] == pytest.approx(95.0, abs=0.01)


@pytest.mark.parametrize("speed_m_s", [-8.0, -3.0, -0.5])
def test_in_reverse_the_tension_is_kept_as_long_as_the_line_runs(speed_m_s):
    """200 lengths of the span at the highest speed."""
    tensions = run(speed_m_s, 95.0, 25.0)
    assert max(tensions) < 95.0 + 0.2 * 15.0
    assert tensions[round(5.0 / CYCLE_S) :] == pytest.approx([95.0] * round(20.0 / CYCLE_S), abs=0.05)


def test_an_open_loop_goes_to_the_ratio_that_the_direction_of_the_web_asks_for():
    for speed_m_s, ratio in (
        (3.0, (1 + STRAIN_PREV) / (1 + 95.0 / STIFFNESS_N)),
        (-3.0, (1 + 95.0 / STIFFNESS_N) / (1 + STRAIN_NEXT)),
    ):
        controller = controller_of(TensionControlConfig())
        velocity(controller, speed_m_s, 95.0, 95.0)
        for _ in range(3000):
            found = hold(controller, speed_m_s, 95.0)
        assert found == pytest.approx(ratio * speed_m_s, abs=1e-8)


@pytest.mark.parametrize("speed_m_s", [0.0, 0.1, 0.5])
def test_where_the_span_is_slow_the_loop_still_settles_within_its_own_time(speed_m_s):
    tensions = run(speed_m_s, 95.0, 6.0)
    assert max(tensions) < 95.0 + 0.2 * 15.0
    assert tensions[round(3.0 / CYCLE_S) :] == pytest.approx([95.0] * round(3.0 / CYCLE_S), abs=0.7)
    assert tensions[-1] == pytest.approx(95.0, abs=0.05)


def test_a_roller_that_gives_way_is_driven_harder_by_what_it_gives():
    """Roller 2 on a spring: (1 + κ)·F' = (ES/L)·c − (v/L)·F; the loop is as fast as with a stiff roller."""
    stiffness_N_per_m = 18750.0
    kappa = STIFFNESS_N / (LENGTH_M * stiffness_N_per_m)
    controller = controller_of(TensionControlConfig(bandwidth_rad_per_s=6.0), stiffness_N_per_m)
    deviation_N, course = 16.0, []
    for _ in range(round(3.0 / CYCLE_S)):
        v1 = velocity(controller, 3.0, 80.0, 80.0 + deviation_N)
        rate = STIFFNESS_N / LENGTH_M * (3.0 - v1) - 3.0 / LENGTH_M * deviation_N
        deviation_N += CYCLE_S * rate / (1 + kappa)
        course.append(deviation_N)
    assert all(abs(value) < 3.0 for value in course[round(0.6 / CYCLE_S) :])
    assert course[-1] == pytest.approx(0.0, abs=0.05)


def test_the_correction_is_limited_and_does_not_wind_up():
    controller = controller_of(TensionControlConfig(correction_limit_m_s=0.001))
    for _ in range(5000):
        assert velocity(controller, 3.0, 500.0, 80.0) == pytest.approx(3.0 - 0.001)
    for _ in range(3):
        v1 = velocity(controller, 3.0, 80.0, 90.0)
    assert v1 > 3.0 - 0.001


def test_an_open_loop_goes_without_a_bump_to_the_ratio_of_the_set_point_and_closes_without_one():
    controller = controller_of(TensionControlConfig(bandwidth_rad_per_s=3.0))
    for _ in range(2000):
        before = velocity(controller, 3.0, 95.0, 60.0)
    held = hold(controller, 3.0, 95.0)
    assert held == pytest.approx(before, abs=5e-5)
    assert abs(before - 3.0) > 1e-3  # where it came from is far from where it goes
    for _ in range(3000):
        held = hold(controller, 3.0, 95.0)
    assert held == pytest.approx(3.0 * (1 + STRAIN_PREV) / (1 + 95.0 / STIFFNESS_N), abs=1e-7)
    assert hold(controller, 1.5, 95.0) == pytest.approx(0.5 * held, abs=1e-7)
    assert velocity(controller, 3.0, 95.0, 60.0) == pytest.approx(held, abs=1e-5)


@pytest.mark.parametrize("speed_m_s", [0.05, 3.0, -3.0])
def test_gains_are_those_that_the_loop_goes_by(speed_m_s):
    controller = controller_of(TensionControlConfig(correction_limit_m_s=1.0), 18750.0)
    kp, ki = gains_at(controller, speed_m_s, 8.7e9)
    velocity(controller, speed_m_s, 80.0, 80.0)
    corrections = [speed_m_s - velocity(controller, speed_m_s, 80.0, 79.0) for _ in range(3)]
    assert corrections == pytest.approx([kp + k * ki * CYCLE_S for k in (1, 2, 3)], rel=1e-9)
