"""What torques and encoders allow a twin to say of a tension: the balance, its bounds, and how long it takes."""

from __future__ import annotations

from collections.abc import Callable
from math import nan, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilbench.bench.tasks import tension_bounds as bounds
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.runs.config import load_with_overrides

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
BLOCK_S, SET_POINT_N, SECTION_M2, MODULUS_PA = 0.1, 80.0, 3.25e-5, 8.7e9
#: Usual errors of a model: friction of 8 N at rest and 8 N at 3 m/s.
FRICTION_N, AT_SPEED_M_S = 8.0, 3.0


@pytest.fixture(autouse=True)
def without_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Python runs them: what is compiled is what the runs of `test_tension_watch.py` go by."""
    for name, function in vars(bounds).copy().items():
        if getattr(function, "__module__", "") == bounds.__name__ and hasattr(function, "py_func"):
            monkeypatch.setattr(bounds, name, function.py_func)


def demonstrator() -> ModelParameters:
    return load_with_overrides(SHIPPED).config.web_line


def records(count: int, kind: np.dtype) -> Any:
    return np.zeros(count, kind).view(np.recarray)


def figures(**changes: float) -> Any:
    f = records(1, bounds.SPAN)[0]
    f.usual_N, f.usual_m2 = SET_POINT_N, SET_POINT_N / MODULUS_PA
    f.strain_share, f.creep_share, f.next_N = 0.02, 0.6, 70.0
    f.warms_N, f.of_speed, f.changes = FRICTION_N, FRICTION_N / AT_SPEED_M_S, 1.0
    for name, value in changes.items():
        f[name] = value
    return f


class Opinion:
    """The verdicts on a twin, block by block; tensions in N by the time in s."""

    def __init__(self, f: Any = None) -> None:
        self.f = figures() if f is None else f
        self.state = records(1, bounds.STATE)[0]
        self.ring = records(bounds.BLOCKS, bounds.BLOCK)
        self.t_s = 0.0
        self.said: list[tuple[float, float]] = []

    def see(
        self,
        until_s: float,
        twin_N: Callable[[float], float] = lambda t: SET_POINT_N,
        torques_N: Callable[[float], float] = lambda t: SET_POINT_N,
        twin_Pa: float = MODULUS_PA,
        strain: float = SET_POINT_N / (MODULUS_PA * SECTION_M2),
        **changes: float,
    ) -> None:
        while self.t_s < until_s - 1e-9:
            self.t_s += BLOCK_S
            block = records(1, bounds.BLOCK)[0]
            block.tension_N, block.twin_N = torques_N(self.t_s), twin_N(self.t_s)
            block.variance_N2, block.turning_N = 2.0 * FRICTION_N**2, 1.0
            block.twin_Pa, block.stretch_m2 = twin_Pa, SECTION_M2 * strain
            block.line_m_s, block.block_s = 3.0, BLOCK_S
            block.closed = block.unchanged = 1.0
            for name, value in changes.items():
                block[name] = value
            if bounds.judge(self.f, self.state, self.ring, block):
                self.said.append((self.t_s, float(self.state.reported)))


def test_the_balance_of_the_rollers_behind_a_span_is_its_tension() -> None:
    """F = (i/r)·τ + F_next − m·v': 0.8 N·m at a gear of 5 and 0.2 m are 20 N, and 2 m/s² of the mass are taken off."""
    model = demonstrator()
    rollers, motion, block = records(2, bounds.ROLLER), records(2, bounds.MOTION), records(1, bounds.BLOCK)[0]
    rollers[1].rad_per_m, rollers[1].mass_kg = 25.0, model.mass_kg(2)
    rollers[1].dry_N, rollers[1].viscous = 8.0, 2.0
    rollers[1].scale, rollers[1].inertia_kg, rollers[1].radius_m = 0.1, 3.0, 0.2
    rollers[1].unbalance_N = 4.0
    motion[1] = 0.8, 3.0, 2.0
    block.tension_N = 70.0
    bounds.momentum_balance(lay.pack(model), figures(), rollers, motion, 1, 1.0, block)
    assert block.tension_N == pytest.approx(70.0 + 20.0 - 2.0 * model.mass_kg(2))
    assert block.variance_N2 == pytest.approx(8.0**2 + 6.0**2 + 2.0**2 + 6.0**2)
    assert block.turning_N == pytest.approx(4.0 * 2.0 * 0.2 / 3.0)  # of a swing over 3 m of a roller of 0.2 m


def test_a_roller_that_stands_may_hold_by_the_dry_friction_of_the_model() -> None:
    entry = {"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": 5.0}}
    model = ModelParameters.model_validate(demonstrator().model_dump() | {"effects": [entry]})
    rollers, motion, block = records(2, bounds.ROLLER), records(2, bounds.MOTION), records(1, bounds.BLOCK)[0]
    bounds.momentum_balance(lay.pack(model), figures(), rollers, motion, 1, 1.0, block)
    assert block.sticks_N == 5.0
    motion[1].speed_m_s = 1.0
    bounds.momentum_balance(lay.pack(model), figures(), rollers, motion, 1, 1.0, block)
    assert block.sticks_N == 0.0


@pytest.mark.parametrize("forward", [True, False])
def test_the_web_in_the_spans_comes_to_the_strains_of_mass_conservation(forward: bool) -> None:
    lengths_m, strains = np.array([1.0, 2.0]), np.zeros(2)
    unstretched_m = lengths_m.copy()
    speeds = np.array([1.0, 1.0002, 1.0003]) * (1.0 if forward else -1.0)
    for _ in range(40_000):
        bounds.stretch(unstretched_m, strains, lengths_m, 1e-3 * speeds, 1e-4, 5e-4)
    if forward:
        assert strains + 1.0 == pytest.approx((1.0 + 1e-4) * speeds[1:] / speeds[0], abs=1e-8)
    else:
        assert strains + 1.0 == pytest.approx((1.0 + 5e-4) * speeds[:2] / speeds[2], abs=1e-8)


@pytest.mark.parametrize(
    ("twin_N", "within_s"),
    [
        (lambda t: 1.3 * SET_POINT_N if t > 25.0 else SET_POINT_N, 1.5),
        (lambda t: SET_POINT_N * (1.0 + 0.02 * max(t - 25.0, 0.0)), 5.0),
        (lambda t: nan if t > 25.0 else SET_POINT_N, 1.5),
    ],
)
def test_a_tension_that_moves_as_no_torque_does_is_said(twin_N: Callable[[float], float], within_s: float) -> None:
    opinion = Opinion()
    opinion.see(35.0, twin_N)
    assert [said for _, said in opinion.said] == [bounds.CHANGE]
    assert 25.0 < opinion.said[0][0] <= 25.0 + within_s + 1e-9


def test_a_tension_that_stays_while_the_torques_say_that_it_has_changed_is_said() -> None:
    opinion = Opinion()
    opinion.see(30.0, torques_N=lambda t: 96.6 if t > 25.0 else 80.0)
    assert [said for _, said in opinion.said] == [bounds.CHANGE]
    assert opinion.state.assumed_Pa == pytest.approx(MODULUS_PA * 96.6 / 80.0, rel=0.02)


def test_what_no_usual_errors_of_a_model_explain_is_said_whatever_was_before() -> None:
    """3·√(8² + 8² + 1) N are 34.1 N."""
    for off_N, said in ((33.0, []), (35.0, [bounds.TENSION])):
        opinion = Opinion()
        opinion.see(10.0, lambda t: SET_POINT_N + off_N)  # noqa: B023
        assert [what for _, what in opinion.said] == said


def test_an_E_that_torques_and_encoders_do_not_allow_is_said() -> None:
    opinion = Opinion()
    opinion.see(5.0, twin_Pa=2.0 * MODULUS_PA)
    assert [said for _, said in opinion.said] == [bounds.MODULUS]
    assert opinion.state.low_Pa < MODULUS_PA < opinion.state.high_Pa < 2.0 * MODULUS_PA


@pytest.mark.parametrize("lasts_s", [0.2, 0.7])
def test_an_E_that_a_twin_looks_for_for_less_than_a_second_is_no_event(lasts_s: float) -> None:
    opinion = Opinion()
    opinion.see(20.0, torques_N=lambda t: 112.0 if 10.0 < t < 10.0 + lasts_s else 80.0)
    assert opinion.said == []


def test_a_swing_of_the_tension_once_a_turn_and_friction_that_warms_up_are_no_events() -> None:
    opinion = Opinion()
    turns_Hz = 3.0 / (2.0 * pi * 0.2)
    opinion.see(120.0, torques_N=lambda t: 80.0 + 6.0 * sin(2.0 * pi * turns_Hz * t) - 0.05 * t)
    assert opinion.said == []


@pytest.mark.parametrize(("amplitude_N", "frequency_Hz"), [(4.0, 0.3), (6.0, 0.125), (3.0, 0.6)])
def test_a_tension_upstream_that_swings_is_no_event(amplitude_N: float, frequency_Hz: float) -> None:
    opinion = Opinion()
    opinion.see(120.0, torques_N=lambda t: 80.0 + amplitude_N * sin(2.0 * pi * frequency_Hz * t))
    assert opinion.said == []


def test_an_open_loop_is_told_another_E_that_the_torques_show() -> None:
    opinion = Opinion()
    opinion.see(15.0, lambda t: 1.3 * SET_POINT_N if t > 10.0 else SET_POINT_N)
    opinion.see(20.0, lambda t: 1.3 * SET_POINT_N, lambda t: 0.8 * SET_POINT_N, closed=0.0)
    assert opinion.state.assumed_Pa == pytest.approx(0.8 * MODULUS_PA, rel=0.02)
    assert {said for _, said in opinion.said} == {bounds.CHANGE}


def test_a_twin_that_finds_behind_a_step_of_E_that_it_was_friction_before_is_no_event() -> None:
    """E by torques steps by 20 %, and the twin's with it; 2 s later it takes 14 N of friction out of it."""
    opinion = Opinion()
    opinion.see(10.0)
    opinion.see(12.0, lambda t: 96.0, lambda t: 96.0, twin_Pa=1.2 * MODULUS_PA)
    opinion.see(30.0, lambda t: 80.0, lambda t: 94.0, twin_Pa=1.02 * MODULUS_PA)
    assert opinion.said == []


@pytest.mark.parametrize("name", ["unchanged", "closed"])
def test_a_difference_is_another_one_when_somebody_has_changed_the_conditions(name: str) -> None:
    opinion = Opinion()
    opinion.see(10.0)
    opinion.see(10.5, **{name: 0.0})
    opinion.see(20.0, lambda t: 95.0)
    assert opinion.said == []


def test_a_method_that_takes_longer_for_a_step_is_judged_by_the_usual_errors_alone() -> None:
    opinion = Opinion(figures(changes=0.0))
    opinion.see(20.0, torques_N=lambda t: 96.6 if t > 10.0 else 80.0)
    assert opinion.said == []


def test_a_twin_that_is_back_for_five_seconds_is_believed_again() -> None:
    opinion = Opinion()
    opinion.see(30.0, lambda t: 1.3 * SET_POINT_N if 10.0 < t < 15.0 else SET_POINT_N, closed=1.0)
    assert [said for _, said in opinion.said] == [bounds.CHANGE, bounds.NOTHING]
    assert 20.0 < opinion.said[1][0] < 21.5


def test_a_twin_that_is_not_back_stays_refused_at_another_speed_and_at_rest() -> None:
    opinion = Opinion()
    opinion.see(15.0, lambda t: 1.3 * SET_POINT_N if t > 10.0 else SET_POINT_N)
    opinion.see(40.0, lambda t: 1.3 * SET_POINT_N, line_m_s=2.0, closed=0.0)
    opinion.see(60.0, lambda t: 1.3 * SET_POINT_N, line_m_s=0.0, closed=0.0)
    assert [said for _, said in opinion.said] == [bounds.CHANGE]
