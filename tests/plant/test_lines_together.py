"""Lines on measured motion in one call: together as each alone, with load motors as by its parts, and handed over."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from random import Random
from typing import Any

import numpy as np
import pytest
from tests.twin.beside_stations import dancer_line, guided_line, winding_line

from hilbench.bench.tasks.load_model import LoadModel
from hilbench.plant.measured_motion import HasFollowed
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.sample_coherence import play
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower, PerturbedCopies, StateTransfer
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_travel_m

CYCLE_S = 0.003
LINES = {"dancer": dancer_line, "idlers": guided_line, "reels": winding_line}
EVERY_LINE = pytest.mark.parametrize("model", LINES.values(), ids=LINES.keys())


def motion(axes: int, cycles: int, seed: int) -> list[list[float]]:
    """Positions of the driven rollers: the line speeds up, goes on and slows down, each roller a little otherwise."""
    random, x, found = Random(seed), np.zeros(axes), []
    draws = 1.0 + 1e-4 * np.array([random.uniform(-1.0, 1.0) for _ in range(axes)])
    for cycle in range(cycles):
        speed = min(cycle, cycles - cycle, cycles // 3) / (cycles // 3)
        x = x + CYCLE_S * speed * draws * (1.0 + 1e-5 * random.uniform(-1.0, 1.0))
        found.append(x.tolist())
    return found


@EVERY_LINE
def test_together_they_do_what_each_does_alone(model: Callable[[], ModelParameters]) -> None:
    further_m = [0.0, 2e-5, -3e-5]
    alone, beside = ([LineFollower(model()) for _ in further_m] for _ in range(2))
    together, axes = PerturbedCopies(beside), model().axis_count
    for each in (alone, beside):
        each[1].set_parameter("span1.youngs_modulus_Pa", 9.1e9)
        for follower, more in zip(each, further_m, strict=True):
            follower.reset([more] * axes)
    together.offsets_m[:] = np.array(further_m)[:, None]
    for x in motion(axes, 300, 1):
        together.follow(x, CYCLE_S)
        for follower, more in zip(alone, further_m, strict=True):
            follower.follow([of + more for of in x], CYCLE_S)
    for row, (follower, other) in enumerate(zip(alone, beside, strict=True)):
        assert other.outputs() == follower.outputs()
        assert together.tensions_N[row].tolist() == follower.tension_N.tolist()
        assert together.motions[row].tolist() == follower.motion.tolist()
    assert together.ratios.tolist() == [alone[0].radius_ratio(axis) for axis in range(1, axes + 1)]
    assert together.tensions_N[0].tolist() != together.tensions_N[1].tolist()


@EVERY_LINE
def test_they_go_on_from_a_motion_that_is_put(model: Callable[[], ModelParameters]) -> None:
    axes = model().axis_count
    first, second = LineFollower(model()), LineFollower(model())
    travels = motion(axes, 200, 2)
    for x in travels[:100]:
        first.follow(x, CYCLE_S)
    together = PerturbedCopies([second])
    together.motions[0] = first.motion
    together.put()
    assert second.tension_N == pytest.approx(first.tension_N, rel=1e-9)
    second.followed.history[:], second.followed.rollers[:] = first.followed.history, first.followed.rollers
    for x in travels[100:]:
        first.follow(x, CYCLE_S)
        second.follow(x, CYCLE_S)
    assert second.tension_N == pytest.approx(first.tension_N, rel=1e-6)


@EVERY_LINE
def test_a_closed_line_takes_over_all_that_no_motor_drives(model: Callable[[], ModelParameters]) -> None:
    follower, ports = LineFollower(model()), [MotorPort() for _ in range(model().axis_count)]
    line = Line(model(), ports)
    for x in motion(len(ports), 90, 3):
        follower.follow(x, CYCLE_S)
    before = line.outputs()
    StateTransfer(follower, line)()
    has, found = follower.get_state().values, line.get_state().values
    driven = {f"{name}{axis}_{unit}" for axis in range(1, len(ports) + 1) for name, unit in _OF_AN_AXIS}
    assert {name for name in found if found[name] != pytest.approx(has[name], rel=1e-12)} <= driven
    assert all(line.outputs()[name] == before[name] for name in driven)
    assert line.tension_N == pytest.approx(follower.tension_N, rel=1e-12)
    StateTransfer(follower, line, [2])()
    assert line.outputs()["x2_m"] == follower.outputs()["x2_m"] != before["x2_m"]
    assert line.outputs()["x1_m"] == before["x1_m"]


_OF_AN_AXIS = (("x", "m"), ("v", "m_s"), ("tau", "Nm"))


class ByItsParts:
    """A follower that is asked one thing after the other."""

    def __init__(self, line: Any) -> None:
        for name in ("describe", "reset", "follow", "load_torques_Nm", "outputs", "set_parameter"):
            setattr(self, name, getattr(line, name))


def load_models(model: ModelParameters) -> tuple[LoadModel, LoadModel]:
    """The same with a line that follows in one call, and with one that does not; load motors on all axes but the
    first."""
    least_m = least_travel_m(model, CYCLE_S)
    own = None if isfinite(least_m) else play("m", CYCLE_S)
    axes = range(2, model.axis_count + 1)
    lines = LineFollower(model), ByItsParts(LineFollower(model))
    whole, parts = (LoadModel(line, axes, CYCLE_S, 0.0045, least_m, own_play=own) for line in lines)  # type: ignore[arg-type]
    return whole, parts


@EVERY_LINE
@pytest.mark.parametrize("seed", range(3))
def test_in_one_call_load_motors_pull_as_by_its_parts(model: Callable[[], ModelParameters], seed: int) -> None:
    """Late ones, positions that are not of one instant, cycles that are missing, another E, a web that tears."""
    whole, parts = load_models(model())
    axes, outputs = model().axis_count, len(whole.machine.describe().outputs)
    first = 3 * axes - 1
    values = np.zeros(first + outputs)
    places = np.array([*range(first), *(each for at in range(outputs) for each in (first + at, at))], np.int64)
    random, kinds, last = Random(seed), set(), [0.0] * axes
    for cycle, now in enumerate(motion(axes, 240, seed)):
        late, missing = random.random() < 0.03, random.random() < 0.02
        x = [last[0], *now[1:]] if random.random() < 0.03 else now
        speeds = [(to - of) / CYCLE_S for to, of in zip(now, last, strict=True)]
        last = now
        if missing:
            continue
        if cycle == 100:
            for each in (whole, parts):
                each.machine.set_parameter("span1.youngs_modulus_Pa", 9.5e9)
        if cycle == 200:
            for each in (whole, parts):
                each.machine.set_parameter("broken", 1.0)
        values[: 2 * axes] = [*x, *speeds]
        followed = whole.follow_in(values, places, late=late)
        kinds.add(followed)
        if followed is None:
            values[2 * axes : first] = whole.update(x, speeds, late=late)
        assert values[2 * axes : first].tolist() == parts.update(x, speeds, late=late)
        assert list(whole.outputs()) == list(parts.outputs())
        if followed is HasFollowed.ALL:
            assert values[first:].tolist() == list(parts.outputs())
    assert kinds == {None, HasFollowed.NOT, HasFollowed.ALL}
