"""A line in reverse: web comes in at the last roller, and passes each with the strain of where it comes from."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from tests.independent_line import Line
from tests.independent_line import effect as hidden
from tests.independent_line.spans import LineOfSpans, at_span
from tests.tiers import slow

from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import offline
from hilbench.plant.web_line.line_inverse import required_torques
from hilbench.plant.web_line.parameters import ModelParameters

from .cycles import follow
from .models import effect, line_of, model

STIFFNESS_N = 8.7e9 * 0.5 * 65e-6
STRAIN_PREV, STRAIN_NEXT = 80.0 / STIFFNESS_N, 70.0 / STIFFNESS_N
STEP_S = 0.001


def moved_tensions(x_m: np.ndarray, lengths_m: tuple[float, ...], other: slice, change: float) -> np.ndarray:
    """Tensions (n, K) of a web of small pieces (unstretched length, E·S), which are taken from a span at the roller
    that they pass, and laid into the one on its other side; x (n, N). What comes in during the rows `other` is other
    web."""
    spans = [deque([(length / (1.0 + STRAIN_PREV), STIFFNESS_N)]) for length in lengths_m]
    tensions = np.empty((len(x_m), len(spans)))
    for row, travels_m in enumerate(np.diff(x_m, axis=0, append=x_m[-1:])):
        for k, (span, length) in enumerate(zip(spans, lengths_m, strict=True)):
            tensions[row, k] = (length - sum(m for m, _ in span)) / sum(m / stiff for m, stiff in span)
        for roller, travel_m in enumerate(travels_m):
            before, behind = roller - 1, roller if roller < len(spans) else -1
            comes_from, goes_to = (before, behind) if travel_m >= 0.0 else (behind, before)
            going, left = [], abs(travel_m)
            if comes_from < 0:
                strain = STRAIN_PREV if travel_m >= 0.0 else STRAIN_NEXT
                is_other = travel_m >= 0.0 and other.start <= row < other.stop
                going, left = [(left / (1.0 + strain), STIFFNESS_N * (1.0 + change if is_other else 1.0))], 0.0
            while left > 1e-15:
                source = spans[comes_from]
                m, stiff = source.pop() if travel_m >= 0.0 else source.popleft()
                stretched = max(m, 1e-18) * (1.0 + tensions[row, comes_from] / stiff)
                share = min(left / stretched, 1.0)
                going.append((m * share, stiff))
                left -= stretched * share
                if share < 1.0:
                    rest = (m * (1.0 - share), stiff)
                    source.append(rest) if travel_m >= 0.0 else source.appendleft(rest)
            if goes_to >= 0:
                spans[goes_to].extendleft(going) if travel_m >= 0.0 else spans[goes_to].extend(going)
    return tensions


def forward_and_back(rows: int, turns_s: float) -> np.ndarray:
    """Positions (n, 3), m: at 1.6 m/s, from `turns_s` on as fast in reverse, with spans drawn in both directions."""
    share = -np.tanh((np.arange(rows) * STEP_S - turns_s) / 0.05)
    speeds = 1.6 * share[:, None] + np.abs(share)[:, None] * np.array([0.0, 1.6e-4, 4e-4])
    return np.cumsum(speeds * STEP_S, axis=0)


@pytest.mark.parametrize("change", [0.0, 1.0, *slow(-0.4)])
def test_web_goes_back_with_the_strain_of_where_it_comes_from_and_a_splice_with_it(change: float) -> None:
    rows, comes = 2400, slice(200, 356)
    line = line_of(3, effect("splice", time_s=0.2, relative_change=change, length_m=0.25)) if change else line_of(3)
    x = forward_and_back(rows, 1.0)
    boundary = np.tile([STRAIN_PREV, 70.0], (rows, 1))
    found, expected = follow(line, x, boundary, STEP_S), moved_tensions(x, (1.0, 1.2), comes, change)
    plain = follow(line_of(3), x, boundary, STEP_S)
    size = np.ptp(plain, axis=0) if change == 0.0 else np.abs(expected - plain).max(axis=0)
    assert np.all(size > 5.0)
    assert np.all(np.abs(found - expected).max(axis=0) < 0.02 * size)


def test_in_reverse_a_span_forgets_its_strain_as_it_does_forward() -> None:
    """m' = v2/(1 + strain_next) - v1·m/L at constant speeds, solved; over 200 lengths of the span."""
    rows, (v1, v2) = 10_000, (-4.0004, -4.0)
    t = np.arange(rows) * 0.005
    x = t[:, None] * np.array([v1, v2])
    found = follow(model(), x, np.tile([STRAIN_PREV, 70.0], (rows, 1)), 0.005)[:, 0]
    last = v2 / v1 / (1.0 + STRAIN_NEXT)
    material = last + (1.0 / (1.0 + STRAIN_PREV) - last) * np.exp(v1 * t)
    np.testing.assert_allclose(found, STIFFNESS_N * (1.0 / material - 1.0), atol=1e-4)


def test_in_reverse_the_web_slips_the_way_that_it_is_pulled() -> None:
    """Over roller 2, which 10 N more pull back than forward: what it holds back is lost to heat in both directions."""
    rows, creep = 6000, 1e-5
    for speed, comes_from in ((2.0, STRAIN_PREV), (-2.0, STRAIN_NEXT)):
        x = np.arange(rows)[:, None] * 0.002 * np.array([speed, speed])
        slipping = model(effect("web_slip", creep_per_N=creep))
        force = follow(slipping, x, np.tile([STRAIN_PREV, 70.0], (rows, 1)), 0.002)[-1, 0]
        strain, passes = force / STIFFNESS_N, 2.0 - np.sign(speed) * creep * (force - 70.0) * 2.0
        into, out_of = (2.0, passes) if speed > 0.0 else (passes, 2.0)
        assert into / (1.0 + comes_from) == pytest.approx(out_of / (1.0 + strain), abs=1e-12)


def test_a_line_that_stops_and_goes_back_is_continuous_and_what_follows_it_agrees() -> None:
    line = line_of(3)
    rows = 1600
    commands = 2.0 * np.sin(np.pi * np.arange(rows) / 500.0)[:, None] * np.array([1.0, 1.0001, 1.0003])
    boundary = np.tile([STRAIN_PREV, 70.0], (rows, 1))
    p = lay.pack(line)
    run = offline.simulate(p, offline.start_state(p, line), commands, boundary, 0.002)
    assert np.count_nonzero(np.diff(np.sign(run.v_m_s[100:, 0]))) >= 3
    np.testing.assert_allclose(follow(line, run.x_m, boundary, 0.002), run.F_N, atol=0.02)
    a = np.gradient(run.v_m_s, 0.002, axis=0)
    needed = required_torques(p, line, run.x_m, run.v_m_s, a, boundary, 0.002)
    np.testing.assert_allclose(needed.F_N[0, 500:], run.F_N[500:], atol=0.02)


def test_the_strain_behind_the_line_stays_when_E_changes_and_follows_the_tension_there() -> None:
    rows = 3000
    x = np.arange(rows)[:, None] * 0.002 * np.array([-3.0, -3.0])
    stepped = effect("elasticity_step", time_s=0.0, relative_change=0.2)
    for behind_N in (70.0, 35.0):
        boundary = np.tile([STRAIN_PREV, behind_N], (rows, 1))
        assert follow(model(), x, boundary, 0.002)[-1, 0] == pytest.approx(behind_N, abs=1e-3)
        assert follow(model(stepped), x, boundary, 0.002)[-1, 0] == pytest.approx(1.2 * behind_N, abs=1e-3)
    given = model(boundary={"upstream_tension_N": 80.0, "downstream_tension_N": 70.0, "downstream_strain": 5e-4})
    boundary = np.tile([STRAIN_PREV, 70.0], (rows, 1))
    assert follow(given, x, boundary, 0.002)[-1, 0] == pytest.approx(5e-4 * STIFFNESS_N, abs=1e-3)


@pytest.mark.parametrize(
    "line",
    [
        Line(hidden=[hidden("elasticity_step", time_s=15.0, relative_change=0.2)]),
        *slow(Line(hidden=[hidden("web_slip", creep_per_N=1e-5)])),
        LineOfSpans(hidden=[at_span(hidden("elasticity_step", time_s=15.0, relative_change=-0.2), 2)]),
    ],
    ids=lambda line: f"{len(line.hidden)} {line.hidden[0]['effect']} of {line.rollers} rollers",
)
def test_the_tensions_of_an_independent_line_in_reverse_are_those_on_its_motion(line: Line) -> None:
    """It moves the web in pieces; at up to 4 m/s, from standstill to standstill."""
    line = replace(line, noise=0.0, encoder_counts=2**24, top_share=-1.0)
    record = line.record("identification", seed=1, duration_s=30.0)
    channels, axes = record.channels, range(1, line.rollers + 1)
    known = ModelParameters.model_validate({**line.model, "effects": [dict(item) for item in line.hidden]})
    x = np.column_stack([channels[f"x{axis}_m"] for axis in axes])
    found = follow(known, x, np.column_stack([channels["strain_prev"], channels["F_next_N"]]), channels["t_s"][1])
    names = ["F_true_N"] if line.rollers == 2 else [f"F{axis}_true_N" for axis in axes[:-1]]
    assert x[-1, -1] < -40.0
    for span, name in enumerate(names):
        assert np.ptp(record.truth[name]) > 10.0
        assert np.abs(found[:, span] - record.truth[name]).max() < 0.02
