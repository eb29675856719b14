"""Laws of motors and their encoders that every machine has."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from hilbench.plant.effects import find_effect
from hilbench.plant.motor_laws import measured_motion, past_torque_Nm, true_motion, value_at

(AMPLITUDE,) = (each for each in find_effect("encoder_error").parameters if each.name == "amplitude_rad")


@pytest.mark.parametrize("amplitude_rad", [0.0, 1e-3, 0.1, AMPLITUDE.upper])
@pytest.mark.parametrize("phase_rad", [0.0, 2.0])
def test_what_an_encoder_makes_of_a_motion_is_undone_up_to_the_largest_error(
    amplitude_rad: float, phase_rad: float
) -> None:
    # An angle that swings, by what it is and not by its derivatives: those of what is measured are differences of it.
    t_s, h_s = np.linspace(0.0, 1.0, 201), 1e-4

    def angle_rad(t: np.ndarray) -> np.ndarray:
        return np.asarray(4.0 * pi * t + 0.8 * np.sin(5.0 * t))

    def measured_rad(t: np.ndarray) -> np.ndarray:
        return np.asarray(angle_rad(t) + amplitude_rad * np.sin(angle_rad(t) + phase_rad))

    rad_s = (measured_rad(t_s + h_s) - measured_rad(t_s - h_s)) / (2.0 * h_s)
    rad_s2 = (measured_rad(t_s + h_s) - 2.0 * measured_rad(t_s) + measured_rad(t_s - h_s)) / h_s**2
    for t, at, speed, acceleration in zip(t_s, measured_rad(t_s), rad_s, rad_s2, strict=True):
        found = true_motion(amplitude_rad, phase_rad, at, speed, acceleration)
        assert found[0] == pytest.approx(angle_rad(t), abs=1e-12)
        assert found[1] == pytest.approx(4.0 * pi + 4.0 * np.cos(5.0 * t), abs=1e-4)
        assert found[2] == pytest.approx(-20.0 * np.sin(5.0 * t), abs=2e-2)
        assert measured_motion(amplitude_rad, phase_rad, *found[:2]) == pytest.approx((at, speed), abs=1e-9)


@pytest.mark.parametrize(("samples", "torque_Nm"), [(0.0, 6.0), (1.0, 5.0), (2.25, 3.75)])
def test_a_torque_of_some_samples_ago_is_read_from_its_ring(samples: float, torque_Nm: float) -> None:
    ring = np.array([9.0, 4.0, 5.0, 6.0, 3.0])  # behind a value that is none of it, samples 8 to 10 and, older, 7
    assert past_torque_Nm(ring, 1, 4, 10, samples) == pytest.approx(torque_Nm)


def test_a_value_between_rows_is_on_the_line_between_them() -> None:
    column = np.array([1.0, 3.0, 2.0])
    assert [value_at(column, row) for row in (0.0, 0.5, 1.0, 1.25, 2.0)] == pytest.approx([1.0, 2.0, 3.0, 2.75, 2.0])
