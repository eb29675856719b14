"""The motion of a profile against what its definition asks of it, and against closed forms."""

from math import sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.cia402.profile_position import ProfileLimits, Trapezoid

positions = st.floats(-1e3, 1e3)
velocities = st.floats(-50.0, 50.0)
rates = st.floats(0.5, 500.0)


@given(positions, velocities, positions, rates, rates, rates)
def test_it_is_continuous_within_its_limits_and_ends_at_rest_at_the_target(
    start: float, velocity: float, target: float, fastest: float, up: float, down: float
) -> None:
    motion = Trapezoid(start, velocity, target, ProfileLimits(fastest, up, down))
    steps = 400
    dt = motion.duration_s / steps
    assert motion.at(0.0) == pytest.approx((start, velocity)) or motion.duration_s == 0.0
    before = (start, velocity)
    for k in range(1, steps + 1):
        now = motion.at(k * dt)
        change = abs(now[1] - before[1])
        assert change <= max(up, down) * dt * (1 + 1e-6) + 1e-9
        assert abs(now[1]) <= max(fastest, abs(velocity)) * (1 + 1e-9) + 1e-9
        # the position is the integral of the velocity, by the trapezoidal rule but for a kink within the step
        kink = 0.5 * (up + down) * dt**2
        assert now[0] - before[0] == pytest.approx(0.5 * (now[1] + before[1]) * dt, abs=kink + 1e-6)
        before = now
    assert motion.at(motion.duration_s) == (target, 0.0)
    assert motion.at(motion.duration_s * (1 - 1e-9))[0] == pytest.approx(target, abs=1e-4)


@pytest.mark.parametrize(
    ("distance", "duration_s"),
    [
        (30.0, 30.0 / 10.0 + 10.0 / 2.0 / 5.0 + 10.0 / 2.0 / 2.5),  # a trapezoid: way by speed, and half of each ramp
        (3.0, sqrt(2.0 * 3.0 * (1 / 5.0 + 1 / 2.5))),  # a triangle
        (-30.0, 30.0 / 10.0 + 10.0 / 2.0 / 5.0 + 10.0 / 2.0 / 2.5),
    ],
)
def test_from_rest_to_rest_it_takes_what_the_closed_form_says(distance: float, duration_s: float) -> None:
    motion = Trapezoid(0.0, 0.0, distance, ProfileLimits(10.0, 5.0, 2.5))
    assert motion.duration_s == pytest.approx(duration_s, rel=1e-12)


def test_too_fast_to_stop_it_comes_back() -> None:
    motion = Trapezoid(0.0, 10.0, 1.0, ProfileLimits(10.0, 5.0, 5.0))
    furthest = max(motion.at(k * motion.duration_s / 1000)[0] for k in range(1001))
    assert furthest == pytest.approx(10.0**2 / (2 * 5.0), rel=1e-4)


def test_it_passes_the_target_with_the_speed_asked_for_where_it_can() -> None:
    limits = ProfileLimits(10.0, 5.0, 5.0)
    assert Trapezoid(0.0, 0.0, 30.0, limits, 10.0).at(1e9) == (30.0, 10.0)
    assert Trapezoid(0.0, 0.0, 1.0, limits, 10.0).at(1e9) == (1.0, 0.0)  # too near
    assert Trapezoid(0.0, 5.0, -30.0, limits, 10.0).at(1e9) == (-30.0, 0.0)  # the other way
