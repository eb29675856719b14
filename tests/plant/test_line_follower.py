"""Idlers, dancers, accumulators and reels on measured motion of the driven rollers."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest

from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters

from .models import effect
from .test_stations import ACCUMULATOR, DANCER, DRIVEN, IDLER, line_with

CYCLE_S = 0.002
LINES = {
    "dancer": line_with(DRIVEN, DANCER, DRIVEN, lengths=[0.5, 0.5]),
    "idler and accumulator": line_with(
        DRIVEN, {"type": "idler", "name": "guide", **IDLER}, ACCUMULATOR, DRIVEN, lengths=[1.0, 0.8, 0.8, 0.8, 0.8]
    ),
    "sticking dancer between stops": line_with(
        DRIVEN,
        {**DANCER, "coulomb_friction_N": 3.0, "lower_stop_m": -0.001, "upper_stop_m": 0.001},
        DRIVEN,
        lengths=[0.5, 0.5],
    ),
}


def driven(model: ModelParameters, seconds: float, draw: float) -> tuple[Line, LineFollower]:
    """A closed line that is brought to 1 m/s with a draw of so much, and its follower on the way of its rollers."""
    ports = [MotorPort() for _ in range(model.axis_count)]
    line, follower = Line(model, ports), LineFollower(model)
    follower.reset([0.0] * model.axis_count)
    for cycle in range(round(seconds / CYCLE_S)):
        speed = min(cycle * CYCLE_S, 1.0)
        for axis, port in enumerate(ports, 1):
            port.mode = MotorMode.VELOCITY
            port.setpoint = speed * (1.0 + draw * (axis - 1)) * model.motor_rad_per_m(axis)
        line.step(CYCLE_S)
        follower.follow(line.x_m.tolist(), CYCLE_S)
    return line, follower


@pytest.mark.parametrize("name", LINES)
def test_it_moves_as_the_closed_line_whose_rollers_it_follows(name: str) -> None:
    line, follower = driven(LINES[name], 3.0, 2e-5)
    assert follower.tension_N == pytest.approx(line.tension_N, abs=0.05)
    found, expected = follower.outputs(), line.outputs()
    for carriage in LINES[name].carriages:
        x = f"x_{carriage.station.name}_m"
        assert abs(expected[x]) > 1e-5
        assert found[x] == pytest.approx(expected[x], abs=1e-6)


def test_of_driven_rollers_alone_it_is_the_web() -> None:
    model = line_with(DRIVEN, DRIVEN, DRIVEN, lengths=[2.0, 3.0], effects=[effect("coulomb_friction", 2, force_N=3.0)])
    whole, web = LineFollower(model), LineFollower(model.model_copy(update={"stations": None}))
    x = np.zeros(3)
    for follower in (whole, web):
        follower.reset(x)
    for cycle in range(500):
        x = x + CYCLE_S * (1.0 + np.array([0.0, 2e-4 * np.sin(cycle / 30), 3e-4 * np.cos(cycle / 20)]))
        for follower in (whole, web):
            follower.follow(x, CYCLE_S)
    assert whole.tension_N == pytest.approx(web.tension_N, abs=1e-6)
    torques = [follower.load_torques_Nm([1, 2, 3], [1.0] * 3, 0.0045) for follower in (whole, web)]
    assert torques[0] == pytest.approx(torques[1], abs=1e-8)


@pytest.mark.parametrize("lead_s", [0.0, 0.0045])
def test_a_guide_roller_takes_the_force_that_speeds_it_up(lead_s: float) -> None:
    """m·a, in what is told of the present as in what load motors pull by, however the cycle lies to its own swing."""
    light = {"type": "idler", "name": "guide", "radius_m": 0.05, "inertia_kg_m2": 0.0025}
    model, m_s2 = line_with(DRIVEN, light, DRIVEN, lengths=[2.0, 3.0]), 0.7
    follower, found = LineFollower(model), []
    follower.reset([0.0, 0.0])
    for cycle in range(1, 601):
        x = 0.5 * m_s2 * (3.0e-3 * cycle) ** 2
        follower.follow([x, x], 3.0e-3)
        tensions_N = follower.predicted_tension_N(lead_s)
        found.append(float(tensions_N[1] - tensions_N[0]))
    assert np.mean(found[-300:]) == pytest.approx(0.0025 / 0.05**2 * m_s2, rel=0.05)


def test_to_look_ahead_changes_nothing() -> None:
    _, follower = driven(LINES["dancer"], 0.5, 2e-5)
    before = follower.outputs()
    follower.load_torques_Nm([2], [0.5, 0.5], 0.0071)
    assert follower.outputs() == before
    assert follower.time_s == pytest.approx(0.5)


def test_any_time_may_have_gone_by() -> None:
    found = []
    for times in ([0.004] * 100, [0.0025, 0.0055] * 50):
        follower = LineFollower(LINES["dancer"])
        follower.reset([0.0, 0.0])
        x = 0.0
        for time_s in times:
            x += 0.01 * time_s
            follower.follow([x, x * (1.0 + 1e-4)], time_s)
        found.append(follower.tension_N)
    assert found[0] == pytest.approx(found[1], abs=0.1)  # its roller swings by 5 N, in steps of other lengths


def reel(kind: str, **changes: Any) -> ModelParameters:
    ends = {"type": kind, "core_radius_m": 0.05, "density_kg_m3": 900.0}
    stations = (ends, DRIVEN) if kind == "unwinder" else (DRIVEN, ends)
    return line_with(*stations, lengths=[1.0], **changes)


@pytest.mark.parametrize(("kind", "winds"), [("unwinder", -1.0), ("rewinder", 1.0)])
def test_a_reels_load_motor_pulls_at_its_present_radius(kind: str, winds: float) -> None:
    model = reel(kind)
    follower, turns = LineFollower(model), 1000.0 / (2.0 * pi * 0.2)  # a kilometre, counted at the first radius
    follower.reset([0.0, 0.0])
    axis = 1 if kind == "unwinder" else 2
    follower.set_state({f"x{axis}_m": 1000.0})
    radius_m = 0.2 + winds * 65e-6 * turns
    assert follower.outputs()[f"r_{kind}_m"] == pytest.approx(radius_m, rel=1e-9)
    [torque] = follower.load_torques_Nm([axis], [0.0, 0.0], 0.0)
    assert torque == pytest.approx(-winds * follower.tension_N[0] * radius_m / 5.0, rel=1e-6)


def test_a_torn_web_pulls_nothing_and_a_dancer_falls_to_its_stop() -> None:
    model = line_with(DRIVEN, {**DANCER, "upper_stop_m": 0.1}, DRIVEN, lengths=[0.5, 0.5])
    follower = LineFollower(model)
    follower.reset([0.0, 0.0])
    follower.set_parameter("broken", 1.0)
    for cycle in range(1, 501):
        follower.follow([cycle * CYCLE_S] * 2, CYCLE_S)
    assert follower.tension_N == pytest.approx([0.0, 0.0], abs=1e-6)
    assert follower.outputs()["x_dancer_m"] == pytest.approx(0.1, abs=1e-9)
    assert follower.load_torques_Nm([2], [1.0, 1.0], 0.004) == pytest.approx(
        [70.0 * 0.2 / 5.0], abs=1e-6
    )  # by what is behind the line
    follower.set_parameter("youngs_modulus_Pa", 9e9)
    assert (follower.parameter("broken"), follower.parameter("youngs_modulus_Pa")) == (1.0, 9e9)
    assert list(follower.tension_N) == [0.0, 0.0]
