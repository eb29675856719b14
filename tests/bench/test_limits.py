"""Every limit warns once, trips, and takes no number for too much."""

from __future__ import annotations

import math

import pytest
from tests.bench.samples import sample_of_two_axes

from hilbench.bench.tasks.limits import LimitTripError, LimitWatch
from hilbench.bench.tasks.web_limits import limit_watch
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.safety import Limit, LimitsConfig
from hilbench.topology.signals import smallest_shapes
from hilbench.twin.virtual_io import TwinStatus

CYCLE_S = 0.002
MODULUS_PA = 8.7e9
MODEL = ModelParameters.model_validate(
    {
        "web": {"youngs_modulus_Pa": MODULUS_PA, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": 1.0},
        "rollers": {"radius_m": 0.2, "inertia_kg_m2": 1.167},
    }
)
LEVELS = Limit(warning=2.0, trip=4.0)


def watch(**limits: Limit) -> LimitWatch:
    none = {name: Limit() for name in LimitsConfig.model_fields}
    return limit_watch(LimitsConfig(**(none | limits)), MODEL, CYCLE_S, smallest_shapes()["web_line"])


@pytest.mark.parametrize(
    ("limit", "signal", "scale", "name"),
    [
        ("tension_N", "F_true_N", 1.0, "tension of the web"),
        ("torque_Nm", "tau_load_Nm", -1.0, "torque of the load motor"),
        ("speed_m_s", "v1_m_s", -1.0, "speed of axis 1"),
        ("position_difference_m", "x2_m", 1.0, "position difference"),
        ("estimate_ratio", "E_sim_Pa", MODULUS_PA, "estimate of E"),
    ],
)
def test_a_quantity_warns_once_until_it_was_well_below_and_then_trips(limit, signal, scale, name):
    limits = watch(**{limit: LEVELS})
    limits.update(sample_of_two_axes())  # where the axes were enabled
    told = []
    for value in (1.0, 1.9, 2.1, 3.0, 1.95, 2.1, 1.8, 2.1):
        sample = sample_of_two_axes(E_sim_Pa=MODULUS_PA, twin_status=int(TwinStatus.SYNCHRONIZED))
        setattr(sample, signal, value * scale)
        told.append([*limits.update(sample), *limits.update(sample)])  # a position difference lasts for two
    assert [len(warnings) for warnings in told] == [0, 0, 1, 0, 0, 0, 0, 1]
    assert name in told[2][0][1]
    for value in (4.1 * scale, math.nan):
        sample = sample_of_two_axes(E_sim_Pa=MODULUS_PA, twin_status=int(TwinStatus.SYNCHRONIZED))
        setattr(sample, signal, value)
        with pytest.raises(LimitTripError, match=f"{name}.* trip level 4"):
            [limits.update(sample) for _ in range(2)]


def test_an_estimate_far_too_small_trips_as_one_far_too_large_but_only_of_a_synchronized_twin():
    limits = watch(estimate_ratio=LEVELS)
    assert not limits.update(sample_of_two_axes(E_sim_Pa=MODULUS_PA / 5.0))
    with pytest.raises(LimitTripError, match="estimate of E"):
        limits.update(sample_of_two_axes(E_sim_Pa=MODULUS_PA / 5.0, twin_status=int(TwinStatus.SYNCHRONIZED)))


def test_what_the_set_points_add_up_to_is_no_position_difference():
    limits = watch(position_difference_m=LEVELS)
    for cycle in range(3000):
        x1_m = 1.0 * CYCLE_S * cycle
        assert not limits.update(sample_of_two_axes(v1_cmd_m_s=1.0, x1_m=x1_m))
    with pytest.raises(LimitTripError, match="position difference"):
        [limits.update(sample_of_two_axes(v1_cmd_m_s=1.0, x1_m=0.0)) for _ in range(2)]


def test_a_single_late_sample_is_no_position_difference():
    limits, speeds = watch(position_difference_m=Limit(warning=0.004, trip=0.2)), {"v1_cmd_m_s": 3.0, "v2_cmd_m_s": 3.0}
    for cycle in range(198):
        x1_m, late = 3.0 * cycle * CYCLE_S, 1 if cycle % 7 == 3 else 0
        sample = sample_of_two_axes(**speeds, x1_m=x1_m, x2_m=x1_m - 3.0 * late * CYCLE_S)
        assert not limits.update(sample)
    sample = sample_of_two_axes(**speeds, x1_m=x1_m + 3.0 * CYCLE_S, x2_m=x1_m - 3.0 * CYCLE_S)
    assert not limits.update(sample)
    assert limits.update(sample)


def test_cycles_that_the_bench_has_missed_are_no_position_difference():
    limits, cycle = watch(position_difference_m=Limit(warning=0.05, trip=0.2)), 0
    for k in range(3000):  # of a film that is drawn by 1 % at 3 m/s; one cycle in ten takes as long as six
        cycle += 6 if k % 10 == 0 else 1
        speeds = {"v1_cmd_m_s": 2.97, "v2_cmd_m_s": 3.0}
        positions = {f"x{axis}_m": cycle * CYCLE_S * speeds[f"v{axis}_cmd_m_s"] for axis in (1, 2)}
        assert not limits.update(sample_of_two_axes(**speeds, **positions))


def test_a_warning_above_the_trip_is_refused():
    with pytest.raises(ValueError, match="not above the trip level 4"):
        Limit(warning=5.0, trip=4.0)
