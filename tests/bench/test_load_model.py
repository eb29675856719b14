"""The load motor's torque from measured motion: the pull of a web that is not there, predicted to when it acts."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from tests.bench.bench_nodes import shipped

from hilbench.bench.tasks.emulated_web import web_load_model
from hilbench.bench.tasks.load_model import LoadModel
from hilbench.plant.measured_motion import HasFollowed
from hilbench.plant.web_line.emulation import lead_s
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.runs.config import load
from hilbench.topology.blocks import LoadConfig
from hilbench.topology.web_line_quantities import WEB_BROKEN, YOUNGS_MODULUS

DANCER = Path(__file__).resolve().parents[2] / "bench_configs" / "line_with_dancer.yaml"
CYCLE_S = 0.002
SPEED_M_S = 1.0
RATIO = 5.0 / 0.2  #: motor shaft in rad per metre of the web
UPSTREAM_N, DOWNSTREAM_N = 80.0, 70.0
FORCE = "load.effects.coulomb_friction.axis2.force_N"


class Line:
    """The two rollers of the shipped bench, as the encoders have them."""

    def __init__(self, load: LoadConfig | None = None) -> None:
        self.config = shipped().model_copy(update={"load": load or LoadConfig()})
        self.model = web_load_model(self.config)
        self.x1_m = self.x2_m = 0.0

    @property
    def tension_N(self) -> float:
        return self.model.machine.outputs()["F1_N"]

    @property
    def strain(self) -> float:
        return self.model.machine.outputs()["strain1"]

    def update(self, v2_m_s: float, *, late: bool = False) -> float:
        """The torque of the load motor in N·m, of the positions as they are."""
        (torque_Nm,) = self.model.update((self.x1_m, self.x2_m), (SPEED_M_S, v2_m_s), late=late)
        return torque_Nm

    def advance(self, draw: float) -> float:
        """The rollers turn for a cycle, roller 2 faster by `draw`; its speed in m/s."""
        v2_m_s = SPEED_M_S * (1.0 + draw)
        self.x1_m += SPEED_M_S * CYCLE_S
        self.x2_m += v2_m_s * CYCLE_S
        return v2_m_s

    def move(self, *, draw: float = 0.0, late: bool = False) -> float:
        """One cycle further; the torque of the load motor in N·m."""
        return self.update(self.advance(draw), late=late)

    def settle(self, draw: float = 0.0) -> float:
        for _ in range(2000):
            torque_Nm = self.move(draw=draw)
        return torque_Nm


def test_the_web_pulls_with_the_difference_of_the_tensions_before_and_behind_roller_2() -> None:
    line = Line()
    torque_Nm = line.settle()
    assert line.tension_N == pytest.approx(UPSTREAM_N, rel=1e-6)
    assert torque_Nm == pytest.approx((DOWNSTREAM_N - UPSTREAM_N) / RATIO, rel=1e-6)


def test_a_faster_roller_2_strains_the_web_by_mass_conservation() -> None:
    line = Line()
    for _ in range(4):
        line.settle(draw=1e-4)
    strain_prev = UPSTREAM_N / (8.7e9 * 0.5 * 65e-6)
    assert line.strain == pytest.approx((1.0 + strain_prev) * (1.0 + 1e-4) - 1.0, rel=1e-3)
    assert line.tension_N == pytest.approx(8.7e9 * 0.5 * 65e-6 * line.strain)


def test_the_torque_is_that_of_the_tension_when_it_acts() -> None:
    """While the web is drawn, the tension grows by ES·Δv/L per second; the torque acts 4 ms after its sample."""
    line = Line()
    line.settle()
    rate_N_s = 8.7e9 * 0.5 * 65e-6 * 1e-4 * SPEED_M_S
    torques_Nm = [line.move(draw=1e-4) for _ in range(2)]
    ahead_N = DOWNSTREAM_N - torques_Nm[-1] * RATIO - line.tension_N
    assert ahead_N == pytest.approx(rate_N_s * 0.004, rel=0.02)


def test_a_step_of_E_changes_the_pull_at_once_and_leaves_the_strain_upstream() -> None:
    line = Line()
    before_Nm = line.settle()
    line.model.set(YOUNGS_MODULUS, 10.5e9)
    assert line.model.value(YOUNGS_MODULUS) == 10.5e9
    after_Nm = line.move()
    assert (before_Nm - after_Nm) * RATIO == pytest.approx(UPSTREAM_N * (10.5 / 8.7 - 1.0), rel=0.01)
    line.settle()
    assert line.tension_N == pytest.approx(UPSTREAM_N * 10.5 / 8.7, rel=1e-6)


def test_a_web_that_has_torn_pulls_no_more_and_has_no_strain() -> None:
    line = Line()
    line.settle()
    line.model.set(WEB_BROKEN, 1.0)
    torque_Nm = line.move()
    assert (line.tension_N, line.strain, line.model.value(WEB_BROKEN)) == (0.0, 0.0, 1.0)
    assert torque_Nm == pytest.approx(DOWNSTREAM_N / RATIO)


def test_while_samples_are_late_the_torque_stays_and_then_no_way_is_lost() -> None:
    held, seen = Line(), Line()
    for line in (held, seen):
        line.settle()
    last_Nm = held.move(draw=1e-4)
    seen.move(draw=1e-4)
    for _ in range(5):
        assert held.move(draw=1e-4, late=True) == last_Nm
        seen.move(draw=1e-4)
    assert held.move(draw=1e-4) == pytest.approx(seen.move(draw=1e-4), rel=1e-3)
    assert held.tension_N == pytest.approx(seen.tension_N, rel=1e-5)


def test_a_sample_of_an_earlier_cycle_is_predicted_over_what_it_is_late_by() -> None:
    """Behind a gap of three cycles comes a sample that is one cycle old: its way says that it took two."""
    line = Line()
    line.settle()
    for _ in range(2):
        line.advance(draw=1e-4)
    for _ in range(2):
        line.update(SPEED_M_S, late=True)
    torque_Nm = line.update(SPEED_M_S)
    ahead_N = DOWNSTREAM_N - torque_Nm * RATIO - line.tension_N
    rate_N_s = 8.7e9 * 0.5 * 65e-6 * 1e-4 * SPEED_M_S
    assert ahead_N == pytest.approx(rate_N_s * (0.004 + CYCLE_S), rel=0.02)


def test_drives_that_were_off_start_with_the_web_as_it_was_at_first() -> None:
    line = Line()
    line.settle(draw=2e-4)
    assert line.tension_N > 1.2 * UPSTREAM_N
    line.model.stop()
    line.move()
    assert line.tension_N == pytest.approx(UPSTREAM_N, rel=1e-6)


def test_an_effect_of_the_emulated_machine_is_set_and_read_by_its_path() -> None:
    line = Line()
    without_Nm = line.settle()
    assert line.model.value(FORCE) == 0.0
    line.model.set(FORCE, 5.0)
    assert line.model.value(FORCE) == 5.0
    assert (without_Nm - line.move()) * RATIO == pytest.approx(5.0, rel=0.01)


def test_an_unknown_path_is_refused() -> None:
    line = Line()
    with pytest.raises(ValueError, match="gremlins"):
        line.model.set("load.effects.gremlins.axis2.force_N", 1.0)


def test_what_the_load_hides_is_no_part_of_what_the_twin_believes() -> None:
    hidden = LoadConfig.model_validate({"web": {"youngs_modulus_Pa": 9.5e9}})
    line = Line(hidden)
    line.settle()
    assert line.model.value(YOUNGS_MODULUS) == 9.5e9
    assert line.tension_N == pytest.approx(UPSTREAM_N * 9.5 / 8.7, rel=1e-6)
    assert line.config.machine.required_web.youngs_modulus_Pa == 8.7e9


class LineInOneCall(Line):
    """Its model follows in a vector, as long as it can; what it shows then is in the vector."""

    def __init__(self) -> None:
        super().__init__()
        outputs = self.model.machine.describe().outputs
        self.shown = list[float]()
        self._values = np.zeros(5 + len(outputs))
        pairs = [each for at in range(len(outputs)) for each in (5 + at, at)]
        self._places = np.array([0, 1, 2, 3, 4, *pairs], np.int64)
        self.followed = list[HasFollowed | None]()

    def update(self, v2_m_s: float, *, late: bool = False) -> float:
        self._values[:4] = self.x1_m, self.x2_m, SPEED_M_S, v2_m_s
        self.followed.append(self.model.follow_in(self._values, self._places, late=late))
        if self.followed[-1] is None:
            self._values[4] = super().update(v2_m_s, late=late)
        self.shown = list(self.model.outputs())
        if self.followed[-1] is HasFollowed.ALL:
            assert self._values[5:].tolist() == self.shown
        return self._values.item(4)


class ByItsParts:
    """A follower that is asked one thing after the other."""

    def __init__(self, web: Any) -> None:
        for name in ("describe", "reset", "follow", "load_torques_Nm", "outputs", "set_parameter"):
            setattr(self, name, getattr(web, name))


@pytest.mark.parametrize("seed", range(3))
def test_in_one_call_the_web_does_what_it_does_by_its_parts(seed: int) -> None:
    """Positions of one instant and not, late ones, cycles that are missing, another E, a web that tears."""
    whole, parts = LineInOneCall(), Line()
    config, web = parts.config, parts.model.machine
    least_m = least_travel_m(config.web_line, CYCLE_S)
    lead = lead_s(config.web_line, CYCLE_S)
    parts.model = LoadModel(ByItsParts(web), config.loaded_axes, CYCLE_S, lead, least_m)  # type: ignore[arg-type]
    random = Random(seed)
    for cycle in range(400):
        for line in (whole, parts):
            if cycle in (150, 300):
                line.model.machine.set_parameter(*(("youngs_modulus_Pa", 9e9) if cycle == 150 else ("broken", 1.0)))
        odd, draw = random.random(), random.gauss(0.0, 1e-5)
        for line in (whole, parts):
            line.advance(draw)
            line.x1_m += (odd < 0.03) * 3e-3  # of another SYNC than roller 2
            if odd > 0.97:
                line.advance(draw)
        torques = [line.update(SPEED_M_S, late=0.5 < odd < 0.55) for line in (whole, parts)]
        assert torques[0] == torques[1]
        assert whole.shown == list(parts.model.outputs())
        for line in (whole, parts):
            line.x1_m -= (odd < 0.03) * 3e-3
    assert {HasFollowed.ALL, HasFollowed.NOT, None} == set(whole.followed)


def test_axes_of_a_dancer_are_of_one_instant_or_nothing_is_followed() -> None:
    """In real time a SYNC is missed, one answer is of the cycle before: the line goes on as if nothing had been."""
    config = load(DANCER)[0]
    model, cycle_s = web_load_model(config), config.cycle_time_s
    speed_m_s, x_m = 0.0, 0.0

    def advance(cycles: int = 1) -> None:
        nonlocal speed_m_s, x_m
        for _ in range(cycles):
            before, speed_m_s = speed_m_s, min(speed_m_s + 1.0 * cycle_s, 1.0)
            x_m += 0.5 * (before + speed_m_s) * cycle_s

    def tensions() -> list[float]:
        names = [quantity.name for quantity in model.machine.describe().outputs]
        found = dict(zip(names, model.outputs(), strict=True))
        return [found[f"F{span}_N"] for span in range(1, 5)]

    for _ in range(500):
        model.update([x_m] * 3, [speed_m_s] * 3)
        advance()
    steady = tensions()
    model.update([x_m] * 3, [speed_m_s] * 3, late=True)
    advance(2)  # one that the bench did not count
    model.update([x_m, x_m, x_m - speed_m_s * cycle_s], [speed_m_s] * 3)
    assert tensions() == steady
    for _ in range(20):
        advance()
        model.update([x_m] * 3, [speed_m_s] * 3)
        assert tensions() == pytest.approx(steady, abs=2.0)
