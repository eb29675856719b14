"""The published tracking simulation on a static plant, whose answer is known in closed form."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.estimation.web_line.balance import BalanceSample
from hilbench.estimation.web_line.config import PidConfig
from hilbench.estimation.web_line.synchronizers.base import Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.pid import PidSynchronizer

CYCLE_S = 0.002
SECTION_M2, STRAIN, METRES_PER_RAD, NEXT_N = 0.5 * 65e-6, 2.8e-4, 0.04, 70.0


def torque_Nm(modulus_Pa: float) -> float:
    return METRES_PER_RAD * (modulus_Pa * SECTION_M2 * STRAIN - NEXT_N)


def plant(start_Pa: float) -> Plant:
    return Plant(start_Pa, 30.0, 1.0 / METRES_PER_RAD, SECTION_M2, 1.0)


def sample(real_Nm: float, sim_Nm: float) -> SyncSample:
    return SyncSample(
        cycle_s=CYCLE_S,
        torque_real_Nm=real_Nm,
        torque_sim_Nm=sim_Nm,
        torque_sim_sensitivity_Nm_per_Pa=METRES_PER_RAD * SECTION_M2 * STRAIN,
        upstream_strain=STRAIN,
        balance=BalanceSample(0.0, real_Nm / METRES_PER_RAD + NEXT_N, SECTION_M2 * STRAIN, 3.0),
    )


def track(config: PidConfig, true_Pa: float, duration_s: float, start_Pa: float = 8.7e9) -> list[float]:
    synchronizer, estimate, curve = PidSynchronizer(config, plant(start_Pa)), start_Pa, []
    for _ in range(round(duration_s / CYCLE_S)):
        estimate = synchronizer.update(sample(torque_Nm(true_Pa), torque_Nm(estimate))).youngs_modulus_Pa
        curve.append(estimate)
    return curve


def test_the_proportional_part_alone_closes_a_constant_gap_exponentially():
    kp = 4.0e8
    config = PidConfig(kp_Pa_per_Nm_s=kp, ki_Pa_per_Nm_s2=0, kd_Pa_per_Nm=0, error_filter_s=0)
    curve = track(config, 10.5e9, 20.0)
    rate_per_s = kp * METRES_PER_RAD * SECTION_M2 * STRAIN
    for time_s in (1.0, 5.0, 15.0):
        expected = 10.5e9 - 1.8e9 * math.exp(-rate_per_s * time_s)
        assert curve[round(time_s / CYCLE_S) - 1] == pytest.approx(expected, rel=2e-4)


def test_the_integral_is_limited():
    config = PidConfig(kp_Pa_per_Nm_s=0, ki_Pa_per_Nm_s2=1e8, kd_Pa_per_Nm=0, error_filter_s=0, integral_limit_Nm_s=0.1)
    synchronizer, estimates = PidSynchronizer(config, plant(8.7e9)), []
    for _ in range(round(2.0 / CYCLE_S)):
        estimates.append(synchronizer.update(sample(1.0, 0.0)).youngs_modulus_Pa)
    per_s = (estimates[-1] - estimates[-501]) / 1.0
    assert per_s == pytest.approx(1e8 * 0.1, rel=1e-9)


def test_a_held_cycle_leaves_the_estimate():
    synchronizer = PidSynchronizer(PidConfig(), plant(8.7e9))
    before = synchronizer.update(sample(0.5, 0.4))
    assert synchronizer.hold(CYCLE_S) == before


def test_the_deviation_speaks_of_the_gap_that_is_not_closed_yet():
    synchronizer = PidSynchronizer(PidConfig(error_filter_s=0.0), plant(8.7e9))
    estimate = synchronizer.update(sample(torque_Nm(10.5e9), torque_Nm(8.7e9)))
    assert estimate.deviation_Pa == pytest.approx(1.8e9, rel=0.2)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_whatever_the_torque_the_estimate_stays_in_its_range(torques):
    config = PidConfig(lower_limit_Pa=5e9, upper_limit_Pa=15e9)
    synchronizer = PidSynchronizer(config, plant(8.7e9))
    for torque in torques:
        assert 5e9 <= synchronizer.update(sample(torque, 0.0)).youngs_modulus_Pa <= 15e9
