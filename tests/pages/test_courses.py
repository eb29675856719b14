"""What is to come of a change, as the page draws it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hilbench.apps.pages.live.controls import courses
from hilbench.prediction.outlook import Outlook, WatchedQuantity

SPIKE = 640


@pytest.fixture
def outlook() -> Outlook:
    """41 futures of 1000 rows from t = 5 s on: those of the tension lie evenly from 80 to 120 N, with a spike."""
    rows = np.zeros((1000, 41, 3))
    rows[:, :, 0] = np.arange(80.0, 121.0)
    rows[SPIKE, :, 0] += 50.0
    rows[:, :, 1] = 2.0
    watched = [
        WatchedQuantity("tension", "F", "N", 150.0, 200.0),
        WatchedQuantity("torque", "tau", "N·m"),
        WatchedQuantity("speed", "v", "m/s"),
    ]
    none = np.zeros((41, 3))
    times_s = 5.0 + 0.01 * np.arange(1, 1001)
    return Outlook(5.0, watched, times_s, rows, none, np.zeros((3, 2)), np.full((41, 3, 2), np.nan), np.zeros(3))


def test_tensions_and_torques_to_come_have_bands_and_levels(outlook: Outlook) -> None:
    tension, torque = courses(outlook)
    assert (tension["name"], tension["unit"]) == ("tension", "N")
    assert tension["levels"] == {"warning": 150.0, "trip": 200.0}
    assert torque["levels"] == {"warning": None, "trip": None}
    assert (tension["low"][0], tension["median"][0], tension["high"][0]) == (82.0, 100.0, 118.0)
    assert tension["t_s"][0] == 0.01
    assert set(torque["low"] + torque["median"] + torque["high"]) == {2.0}


def test_a_spike_to_come_is_in_the_few_points_that_are_sent(outlook: Outlook) -> None:
    tension, _ = courses(outlook)
    assert len(tension["t_s"]) <= 120
    assert max(tension["high"]) == 168.0
    assert len(json.dumps(tension)) < 8000
