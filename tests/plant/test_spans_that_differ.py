"""A web whose E, section and effects differ from span to span."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import write_model
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import offline
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters, load_model

from .cycles import follow
from .models import DEMONSTRATOR, effect, line_of, model

MODULI_PA, WIDTHS_M, LENGTHS_M = [8.7e9, 6.0e9, 9.5e9], [0.5, 0.5, 0.4], [1.0, 1.4, 0.8]
#: Of the spans: relative change of E, offset of the strain, damping (s), relative change of the length, creep (1/N).
SHIFTS, OFFSETS, DAMPINGS_S = [0.0, -0.2, 0.1], [2e-5, 0.0, -1e-5], [0.0, 0.004, 0.002]
STRETCHES, CREEPS = [0.05, 0.0, -0.03], [0.0, 2e-5, 1e-5]
PER_SPAN = {
    "elasticity_shift": ("relative_change", SHIFTS),
    "strain_offset": ("strain", OFFSETS),
    "web_damping": ("time_constant_s", DAMPINGS_S),
    "span_length_error": ("relative_change", STRETCHES),
    "web_slip": ("creep_per_N", CREEPS),
}


def in_span(effect_id: str, span: int, **parameters: float) -> dict[str, Any]:
    return {**effect(effect_id, **parameters), "span": span}


def differing(*effects: dict[str, Any]) -> ModelParameters:
    """Four rollers, three spans."""
    web = {"youngs_modulus_Pa": MODULI_PA, "width_m": WIDTHS_M, "thickness_m": 65e-6, "span_length_m": LENGTHS_M}
    return model(*effects, web=web)


def every_effect() -> list[dict[str, Any]]:
    return [
        in_span(effect_id, span, **{name: value})
        for effect_id, (name, values) in PER_SPAN.items()
        for span, value in enumerate(values, 1)
        if value != 0.0
    ]


def test_a_line_whose_spans_differ_solves_the_equations_of_the_design_in_each() -> None:
    """Against DOP853; the unstretched lengths of the web in the spans are the states here."""
    stiffness = np.array(MODULI_PA) * np.array(WIDTHS_M) * 65e-6
    strain_prev, mass_kg = 80.0 / stiffness[0], (1.167 + 25 * 0.001) / 0.2**2
    lengths = np.array(LENGTHS_M) * (1.0 + np.array(STRETCHES))
    stiff, damping, creep = stiffness * (1.0 + np.array(SHIFTS)), np.array(DAMPINGS_S), np.array(CREEPS)

    def forces(v: np.ndarray, unstretched: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tensions and rates; the tensions enter linearly by creep and damping."""
        segment = lengths / unstretched

        def rates(f: np.ndarray) -> np.ndarray:
            out = v[1:] * (1.0 - creep * (f - np.append(f[1:], 70.0))) / segment
            return np.asarray(np.concatenate([[v[0] / (1.0 + strain_prev)], out[:-1]]) - out)

        def residual(f: np.ndarray) -> np.ndarray:
            growth = -segment * rates(f) / unstretched
            return np.asarray(stiff * (segment - 1.0 - np.array(OFFSETS) + damping * growth) - f)

        base = residual(np.zeros(3))
        f = np.linalg.solve(np.column_stack([residual(unit) - base for unit in np.eye(3)]), -base)
        return f, rates(f)

    def derivative(_: float, y: np.ndarray, command: np.ndarray) -> np.ndarray:
        v, unstretched, torque = y[4:8], y[8:11], y[11:]
        f, rates = forces(v, unstretched)
        around = np.concatenate([[80.0], f, [70.0]])
        acceleration = (25.0 * torque + around[1:] - around[:-1]) / mass_kg
        return np.concatenate([v, acceleration, rates, (command - torque) / 0.001])

    rows, v0 = 100, 3.0
    t = 0.002 * np.arange(rows)
    commands = np.column_stack([0.4 * np.sin(9.0 * t + i) for i in range(4)])
    y = np.concatenate([np.zeros(4), np.full(4, v0), lengths / (1.0 + strain_prev), np.zeros(4)])
    states, expected_N = [], []
    for command in commands:
        states.append(y)
        expected_N.append(forces(y[4:8], y[8:11])[0])
        y = solve_ivp(derivative, (0.0, 0.002), y, method="DOP853", rtol=1e-11, atol=1e-14, args=(command,)).y[:, -1]

    line = differing(*every_effect())
    p = lay.pack(line, substeps=4)
    start = offline.start_state(p, line)
    motion = lay.Layout.of(p).y(start)
    motion[4:8] = motion[12:16] = v0
    boundary = np.tile([line.upstream_strain, 70.0], (rows, 1))
    found = offline.simulate(p, start, commands, boundary, 0.002, MotorMode.TORQUE)
    np.testing.assert_allclose(found.v_m_s, np.array(states)[:, 4:8], rtol=0, atol=2e-8)
    np.testing.assert_allclose(found.F_N, expected_N, rtol=0, atol=3e-4)
    assert np.ptp(expected_N, axis=0).min() > 2.0


@pytest.mark.parametrize("effect_id", list(PER_SPAN))
def test_an_effect_of_one_span_leaves_the_spans_before_it_bit_for_bit(effect_id: str) -> None:
    name, values = PER_SPAN[effect_id]
    rows = 400
    x = 0.002 * np.arange(rows)[:, None] * np.array([1.6, 1.60016, 1.6003, 1.6002])
    boundary = np.tile([differing().upstream_strain, 70.0], (rows, 1))
    plain = follow(differing(), x, boundary, 0.002)
    found = follow(differing(in_span(effect_id, 2, **{name: max(values, key=abs)})), x, boundary, 0.002)
    # Creep sees the tension on the other side of its roller, damping the strain that enters: only behind the span.
    assert np.array_equal(found[:, 0], plain[:, 0])
    assert np.abs(found[:, 1] - plain[:, 1]).max() > 0.05


def test_an_effect_without_a_span_is_that_effect_in_every_span() -> None:
    of_each = [in_span("elasticity_shift", span, relative_change=0.1) for span in (1, 2, 3)]
    together, one_by_one = differing(effect("elasticity_shift", relative_change=0.1)), differing(*of_each)
    np.testing.assert_array_equal(lay.pack(together), lay.pack(one_by_one))


def test_e_of_one_span_is_stepped_while_it_runs_and_its_strain_stays() -> None:
    follower = LineFollower(line_of(3))
    for row in range(1, 200):
        follower.follow((0.003 * row, 0.0030003 * row, 0.0030005 * row), 0.002)
    before, strain = follower.outputs(), follower.strain
    follower.set_parameter("span2.youngs_modulus_Pa", 10.5e9)
    after = follower.outputs()
    assert after["F1_N"] == before["F1_N"]
    assert after["F2_N"] == pytest.approx(before["F2_N"] * 10.5 / 8.7)
    assert (after["E1_Pa"], after["E2_Pa"]) == (8.7e9, 10.5e9)
    np.testing.assert_array_equal(follower.strain, strain)
    follower.set_parameter("youngs_modulus_Pa", 9e9)
    assert [follower.parameter(f"span{k}.youngs_modulus_Pa") for k in (1, 2)] == [9e9, 9e9]


def test_a_closed_line_takes_an_effect_of_a_span_and_gives_it_back() -> None:
    line, plain = Line(line_of(3)), Line(line_of(3))
    line.set_effect("elasticity_shift", section=2, relative_change=0.2)
    assert (line.elasticity_factor(1), line.elasticity_factor(2)) == (1.0, 1.2)
    assert line.tension_N[1] == pytest.approx(1.2 * plain.tension_N[1])
    assert line.tension_N[0] == plain.tension_N[0]
    line.clear_effect("elasticity_shift", section=2)
    for each in (line, plain):
        each.step(0.05)
    assert line.outputs() == plain.outputs()


@pytest.mark.parametrize(
    ("effect_id", "span", "said"),
    [
        ("elasticity_shift", 3, "with span 3, expected 1 to 2"),
        ("elasticity_shift", 0, "with span 0, expected 1 to 2"),
        ("upstream_disturbance", 1, "with span 1, expected none"),
        ("splice", 1, "with span 1, expected none"),
    ],
)
def test_a_span_that_there_is_not_is_refused(effect_id: str, span: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Line(line_of(3)).set_effect(effect_id, section=span)


def test_a_model_of_spans_that_differ_is_written_and_read_back(tmp_path: Path) -> None:
    line = differing(in_span("elasticity_shift", 2, relative_change=0.1), in_span("web_slip", 3, creep_per_N=1e-5))
    write_model(tmp_path / "model.yaml", line)
    again = load_model(tmp_path / "model.yaml")
    assert again == line
    assert [again.stiffness_N(span) for span in (1, 2, 3)] == [8.7e9 * 32.5e-6, 6.0e9 * 32.5e-6, 9.5e9 * 26e-6]
    assert (tmp_path / "model.yaml").read_text(encoding="utf-8").count("span: 2") == 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"youngs_modulus_Pa": [8.7e9, 9e9]}, "youngs_modulus_Pa has 2 values, expected one or 3"),
        ({"thickness_m": []}, "at least 1"),
    ],
)
def test_a_list_of_another_length_than_there_are_spans_is_refused(changes: dict[str, Any], said: str) -> None:
    web = {**DEMONSTRATOR["web"], "span_length_m": LENGTHS_M, **changes}
    with pytest.raises((ValidationError, UnusableInputError), match=said):
        model(web=web, rollers={**DEMONSTRATOR["rollers"], "radius_m": [0.2] * 4})


def test_an_effect_of_all_spans_and_the_same_of_one_is_more_than_there_is_place_for() -> None:
    twice = effect("elasticity_shift", relative_change=0.1), in_span("elasticity_shift", 2, relative_change=0.2)
    with pytest.raises(ValidationError, match="more than 1 times at one place"):
        differing(*twice)
