"""The tension controller on the span's own differential equation, written out here."""

import math

import pytest

from hilbench.bench.tension_control import TensionControlConfig, TensionController

STIFFNESS_N = 8.7e9 * 0.5 * 65e-6
LENGTH_M = 1.0
STRAIN_PREV = 80.0 / STIFFNESS_N
CYCLE_S = 0.002


def run(speed_m_s: float, set_point_N: float, duration_s: float, bandwidth: float = 3.0) -> list[float]:
    controller = TensionController(
        TensionControlConfig(bandwidth_rad_per_s=bandwidth), span_length_m=LENGTH_M, section_m2=0.5 * 65e-6
    )
    strain, tensions = STRAIN_PREV, []
    for _ in range(round(duration_s / CYCLE_S)):
        tension_N = STIFFNESS_N * strain
        v1 = controller.velocity(speed_m_s, set_point_N, tension_N, 8.7e9, CYCLE_S)
        strain += CYCLE_S * (1 + strain) / LENGTH_M * (speed_m_s - v1 * (1 + strain) / (1 + STRAIN_PREV))
        tensions.append(tension_N)
    return tensions


@pytest.mark.parametrize("speed_m_s", [0.3, 3.0, 8.0])
def test_the_loop_is_first_order_with_the_wanted_bandwidth_at_every_line_speed(speed_m_s):
    tensions = run(speed_m_s, 95.0, 3.0)
    for time_s in (0.1, 0.3, 1.0):
        expected = 95.0 - 15.0 * math.exp(-3.0 * time_s)
        assert tensions[round(time_s / CYCLE_S)] == pytest.approx(expected, abs=0.3)
    assert tensions[-1] == pytest.approx(95.0, abs=0.01)


def test_it_holds_at_standstill_without_an_integral():
    assert run(0.0, 90.0, 4.0)[-1] == pytest.approx(90.0, abs=0.01)


def test_the_correction_is_limited_and_does_not_wind_up():
    controller = TensionController(TensionControlConfig(correction_limit_m_s=0.001), 1.0, 0.5 * 65e-6)
    for _ in range(5000):
        assert controller.velocity(3.0, 500.0, 80.0, 8.7e9, CYCLE_S) == pytest.approx(3.0 - 0.001)
    for _ in range(3):
        v1 = controller.velocity(3.0, 80.0, 90.0, 8.7e9, CYCLE_S)
    assert v1 > 3.0 - 0.001
