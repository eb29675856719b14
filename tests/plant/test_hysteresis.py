"""Friction after a reversal: over a way, and behind a play."""

from __future__ import annotations

import numpy as np
import pytest
from tests.plant.models import effect, lone_axis

from hilbench.plant.hysteresis import friction_directions
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm


def directions(x: list[float], half_play: float, presliding: float) -> list[float]:
    out = np.empty(len(x))
    friction_directions(np.array(x), half_play, presliding, out)
    return [round(float(value), 9) for value in out]


def test_friction_turns_over_its_way_after_a_reversal() -> None:
    # Forward beyond the way, then back by it: half way friction is gone, after twice the way it is there the other way.
    assert directions([0.0, 1.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.0], 0.0, 1.0) == [0.0, 1.0, 1.0, 0.5, 0.0, -0.5, -1.0, -1.0]


def test_nothing_holds_while_a_play_is_crossed() -> None:
    there_and_back = [0.0, 4.0, 3.0, 2.0, 1.0, 0.0, -1.0]
    assert directions(there_and_back, 1.0, 1.0) == [0.0, 1.0, 0.0, 0.0, 0.0, -1.0, -1.0]


@pytest.mark.parametrize("gap_m", [0.0, 0.02])
def test_a_drive_pushes_against_friction_again_when_the_play_is_crossed(gap_m: float) -> None:
    axis = lone_axis(effect("coulomb_friction", 1, force_N=5.0), effect("backlash", 1, gap_rad=gap_m))
    x = np.concatenate([np.linspace(0.0, 0.1, 101), np.linspace(0.1, 0.0, 101)[1:]])
    v = np.concatenate([np.full(101, 0.1), np.full(100, -0.1)])
    out = np.empty(len(x))
    required_torque_Nm(lay.pack(axis), x, v, np.zeros(len(x)), 0.01, out)
    per_m = axis.motor_rad_per_m(1)
    back = x[101:][out[101:] < -4.9 / per_m]
    assert 0.1 - back[0] == pytest.approx(gap_m / per_m, abs=0.0021)
    assert out[100] == pytest.approx(5.0 / per_m)
