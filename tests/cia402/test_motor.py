"""The sampled loops of a drive, called as compiled functions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.plant import drive_loops as motor


def test_velocity_loop_is_proportional_plus_sum_of_errors() -> None:
    torque, integral, limited = motor.velocity_loop(0.5, 0.1, 2.0, 30.0, 9.0, 0.001)
    assert integral == pytest.approx(0.1 + 30.0 * 0.5 * 0.001)
    assert torque == pytest.approx(2.0 * 0.5 + integral)
    assert not limited


@given(st.floats(-100.0, 100.0), st.floats(-9.0, 9.0))
def test_integral_never_winds_up_and_torque_keeps_its_limit(error: float, integral: float) -> None:
    for _ in range(50):
        torque, integral, _ = motor.velocity_loop(error, integral, 1.5, 30.0, 9.0, 0.001)
        assert abs(torque) <= 9.0
        assert abs(integral) <= 9.0 + 1e-12


def test_loop_leaves_the_limit_at_once_when_the_error_turns() -> None:
    integral = 0.0
    for _ in range(10_000):
        _, integral, limited = motor.velocity_loop(50.0, integral, 1.5, 30.0, 9.0, 0.001)
        assert limited
    torque, _, limited = motor.velocity_loop(-1.0, integral, 1.5, 30.0, 9.0, 0.001)
    assert not limited
    assert torque < 9.0


def test_ramp_ends_on_the_set_point() -> None:
    reference = 0.0
    for _ in range(7):
        reference = motor.ramp(reference, 1.0, 150.0, 0.001)
    assert reference == 1.0
    assert motor.ramp(0.0, -5.0, np.inf, 0.001) == -5.0


def test_current_loop_is_exact_whatever_the_step() -> None:
    whole = motor.torque_after(0.0, 2.0, motor.current_decay(0.003, 0.001))
    parts = 0.0
    for _ in range(3):
        parts = motor.torque_after(parts, 2.0, motor.current_decay(0.001, 0.001))
    assert parts == pytest.approx(whole, abs=1e-15)
    assert whole == pytest.approx(2.0 * (1.0 - np.exp(-3.0)))
    assert motor.torque_after(0.0, 2.0, motor.current_decay(0.001, 0.0)) == 2.0
