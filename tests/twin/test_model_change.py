"""Another model in a twin that runs: beside the one in use first, then over without a step."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest

from hilbench.plant.motor_port import MotorMode
from hilbench.runs.config import load_with_overrides
from hilbench.topology.web_line import SMALLEST, boundary
from hilbench.twin.machines.kinds import new_machine
from hilbench.twin.machines.machine import TwinMachine
from hilbench.twin.model_switch import HAND_OVER_S, Make, ModelSwitcher, PendingModel, with_effects

CONFIG = load_with_overrides(Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml").config
MODEL = CONFIG.web_line
CYCLE_S = CONFIG.cycle_time_s
SPEED_M_S = 3.0
FRICTION = json.dumps([{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": 5.0}}])
RAD_PER_M = MODEL.motor_rad_per_m(2)


def machine(beside: Callable[[Make], PendingModel] | None = None) -> ModelSwitcher:
    told = boundary(MODEL, SMALLEST)

    def make(effects: str) -> Make:
        changed = with_effects(MODEL, effects)
        return lambda: new_machine(changed, CONFIG.twin, CONFIG.shape, CYCLE_S, told.__getitem__)

    return ModelSwitcher(make, CYCLE_S, beside)


class Line:
    """What is measured of a line at a constant speed, whose web pulls with 80 N and whose axis 2 rubs with 5 N."""

    def __init__(self, twin: ModelSwitcher) -> None:
        self.twin = twin
        self.travel_m = 0.0
        self.shown_N: list[float] = []
        twin.reset()
        before = self.measured()
        self.travel_m += SPEED_M_S * CYCLE_S
        twin.release(before, self.measured())

    def measured(self) -> list[tuple[float, float]]:
        torque_Nm = (80.0 - 70.0 + 5.0) / RAD_PER_M
        return [(self.travel_m * RAD_PER_M, 0.0), (self.travel_m * RAD_PER_M, torque_Nm)]

    def run(self, duration_s: float) -> None:
        twin = self.twin
        for cycle in range(round(duration_s / CYCLE_S)):
            for port in twin.ports:
                port.mode, port.setpoint, port.torque_limit_Nm = MotorMode.VELOCITY, SPEED_M_S * RAD_PER_M, 9.0
            twin.compare(cycle * CYCLE_S, self.measured())
            twin.listen()
            twin.step(CYCLE_S)
            self.travel_m += SPEED_M_S * CYCLE_S
            self.shown_N.append(twin.published()[0])


def test_the_tension_goes_to_that_of_the_changed_model_without_a_step() -> None:
    twin = machine()
    line = Line(twin)
    line.run(3.0)
    before_N = line.shown_N[-1]
    twin.change(FRICTION)
    assert twin.changing
    line.run(4.0 + HAND_OVER_S)
    assert (twin.changing, twin.changed) == (False, True)
    assert line.shown_N[-1] == pytest.approx(before_N - 5.0, abs=0.5)  # the friction was taken for tension
    steps_N = [abs(now - then) for then, now in zip(line.shown_N[1500:], line.shown_N[1501:], strict=False)]
    assert max(steps_N) < 0.1
    assert max(twin.largest_steps[:1]) < 0.1


def test_the_cycle_goes_on_while_the_changed_model_is_made() -> None:
    made: list[tuple[Make, Future[TwinMachine]]] = []

    def beside(make: Make) -> Future[TwinMachine]:
        made.append((make, Future()))
        return made[-1][1]

    twin, other = machine(beside), machine()
    line, without = Line(twin), Line(other)
    for each in (line, without):
        each.run(1.0)
    twin.change(FRICTION)
    for each in (line, without):
        each.run(1.0)
    assert (twin.changing, twin.changed) == (True, False)
    assert line.shown_N == without.shown_N
    ((make, coming),) = made
    coming.set_result(make())
    line.run(4.0 + HAND_OVER_S)
    assert (twin.changing, twin.changed) == (False, True)


def test_a_model_that_comes_after_a_reset_is_not_taken() -> None:
    coming: Future[TwinMachine] = Future()
    twin = machine(lambda make: coming)
    line = Line(twin)
    twin.change(FRICTION)
    twin.reset()
    coming.set_result(twin.in_use)
    line.run(0.1)
    assert (twin.changing, twin.changed) == (False, False)


def test_a_jump_of_the_model_that_is_left_is_a_step_of_the_change_as_far_as_it_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    twin = machine()
    line = Line(twin)
    line.run(3.0)
    twin.change(FRICTION)
    while not twin.largest_steps:
        line.run(CYCLE_S)
    line.run(0.8 * HAND_OVER_S)
    tension_N, *others = twin.in_use.published()
    monkeypatch.setattr(twin.in_use, "published", lambda: [tension_N + 8.0, *others])
    shown_N = abs(twin.published()[0] - line.shown_N[-1])
    assert 0.3 < shown_N < 2.0  # of 8 N, most of which is not shown any more
    assert twin.largest_steps[0] == pytest.approx(shown_N)


def test_a_twin_goes_back_to_the_model_that_was_configured() -> None:
    twin = machine()
    line = Line(twin)
    line.run(3.0)
    twin.change(FRICTION)
    line.run(4.0 + HAND_OVER_S)
    twin.change("")
    line.run(4.0 + HAND_OVER_S)
    assert (twin.changing, twin.changed) == (False, False)


def test_a_reset_twin_has_the_model_that_was_configured() -> None:
    twin = machine()
    line = Line(twin)
    twin.change(FRICTION)
    line.run(1.0)
    twin.reset()
    assert (twin.changing, twin.changed) == (False, False)


@pytest.mark.parametrize(
    "effects",
    ["no list", "[]x", '[{"effect": "no_such_effect"}]', '[{"effect": "coulomb_friction", "axis": 3}]', "{}"],
)
def test_what_is_no_list_of_effects_of_the_machine_is_refused(effects: str) -> None:
    twin = machine()
    with pytest.raises(ValueError):  # noqa: PT011 - whichever of them it is, the twin answers with one abort code
        twin.change(effects)
    assert not twin.changing


def test_no_other_model_is_taken_while_one_is_being_taken_over() -> None:
    twin = machine()
    line = Line(twin)
    line.run(3.0)
    twin.change(FRICTION)
    line.run(3.0)
    with pytest.raises(RuntimeError, match="taken over"):
        twin.change("")
