"""A piece of other web on its way through the spans, against a web of many small pieces that are moved one by one."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from tests.tiers import slow

from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import offline
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower

from .cycles import follow
from .models import effect, line_of, model

STEP_S = 0.0005
SPEEDS = 1.6, 1.60016, 1.6004
COMES_S, LENGTH_M = 0.2, 0.25
STIFFNESS_N, STRAIN_PREV = 8.7e9 * 0.5 * 65e-6, 80.0 / (8.7e9 * 0.5 * 65e-6)


def pieces(splices: list[tuple[float, float]], steps: int) -> np.ndarray:
    """Tensions (steps, 2) of spans of 1 and 1.2 m: each a row of pieces (unstretched length, E·S), first in last.

    `splices`: when each comes in, s, and its relative change; all are `LENGTH_M` long.
    """
    spans = [deque([(length / (1.0 + STRAIN_PREV), STIFFNESS_N)]) for length in (1.0, 1.2)]
    tensions = np.empty((steps, 2))
    for step in range(steps):
        for k, (span, length) in enumerate(zip(spans, (1.0, 1.2), strict=True)):
            unstretched = sum(piece for piece, _ in span)
            tensions[step, k] = (length - unstretched) / sum(piece / stiff for piece, stiff in span)
        stiff = STIFFNESS_N
        for comes_s, change in splices:
            if 0.0 <= (step * STEP_S - comes_s) * SPEEDS[0] < LENGTH_M:
                stiff = STIFFNESS_N * (1.0 + change)
        coming = [(SPEEDS[0] * STEP_S / (1.0 + STRAIN_PREV), stiff)]
        for k, span in enumerate(spans):
            left, going = SPEEDS[k + 1] * STEP_S, []
            while left > 1e-15:
                piece, stiff = span.pop()
                stretched = piece * (1.0 + tensions[step, k] / stiff)
                share = min(left / stretched, 1.0)
                going.append((piece * share, stiff))
                left -= stretched * share
                if share < 1.0:
                    span.append((piece * (1.0 - share), stiff))
            span.extendleft(coming)
            coming = going
    return tensions


@pytest.mark.parametrize("change", [1.0, *slow(-0.4)])
def test_a_splice_is_a_spring_in_series_with_the_web_around_it_in_one_span_after_the_other(change: float) -> None:
    line = line_of(3, effect("splice", time_s=COMES_S, relative_change=change, length_m=LENGTH_M))
    steps = 3600
    x = np.arange(steps)[:, None] * STEP_S * np.array(SPEEDS)
    boundary = np.tile([line.upstream_strain, 70.0], (steps, 1))
    found, expected = follow(line, x, boundary, STEP_S), pieces([(COMES_S, change)], steps)
    plain = follow(line_of(3), x, boundary, STEP_S)
    for k in (0, 1):
        assert np.abs(expected[:, k] - plain[:, k]).max() > 5.0
        assert np.abs(found[:, k] - expected[:, k]).max() < 0.02 * np.abs(expected[:, k] - plain[:, k]).max()
    before = slice(0, round(COMES_S / STEP_S))
    assert np.array_equal(found[before], plain[before])


def test_the_closed_line_and_what_follows_its_motion_have_the_same_splice() -> None:
    """The follower is put back onto every row: what differs is how each goes on between rows."""
    spliced = model(effect("splice", time_s=0.4, relative_change=0.8, length_m=0.3))
    p = lay.pack(spliced)
    commands = np.full((900, 2), 1.5)
    boundary = np.tile([spliced.upstream_strain, 70.0], (900, 1))
    run = offline.simulate(p, offline.start_state(p, spliced), commands, boundary, 0.002)
    np.testing.assert_allclose(follow(spliced, run.x_m, boundary, 0.002), run.F_N, atol=2e-3)


def test_the_moment_a_splice_comes_in_acts_continuously() -> None:
    """Which a search for it needs."""

    def tension(time_s: float) -> float:
        line = line_of(2, effect("splice", time_s=time_s, relative_change=0.8, length_m=0.3))
        x = np.arange(300)[:, None] * 0.002 * np.array(SPEEDS[:2])
        return float(follow(line, x, np.tile([line.upstream_strain, 70.0], (300, 1)), 0.002)[-1, 0])

    found = [tension(0.3001 + 0.0002 * k) for k in range(6)]
    steps = np.diff(found)
    assert np.all(steps < 0.0) or np.all(steps > 0.0)
    assert np.ptp(steps) < 0.1 * np.abs(steps).max()


def test_a_splice_that_is_asked_for_later_than_it_should_have_come_comes_at_once() -> None:
    """Injected by a step of an experiment: whenever its change is set, another one comes."""
    follower = LineFollower(model())
    x, found = 0.0, []
    for row in range(800):
        if row in (100, 700):
            follower.set_effect("splice", relative_change=1.0, length_m=0.1, time_s=0.0)
        x += 0.003
        follower.follow((x, x), 0.002)
        found.append(float(follower.tension_N[0]))
    # 0.1 m of it in 1 m make it stiffer by 1/(1 - 0.05).
    assert found[99] < found[135]
    assert found[150] == pytest.approx(found[99] / 0.95, rel=0.01)
    assert found[735] == pytest.approx(found[699] / 0.95, rel=0.01)


def test_a_line_from_which_a_splice_is_taken_is_as_it_was() -> None:
    line, plain = Line(model()), Line(model())
    line.set_effect("splice", relative_change=1.0, time_s=0.0)
    line.clear_effect("splice")
    for each in (line, plain):
        each.step(0.1)
    assert line.outputs() == plain.outputs()


@pytest.mark.slow
def test_a_second_splice_leaves_the_first_on_its_way_through_the_spans() -> None:
    follower, rows, second_s = LineFollower(line_of(3)), 3600, 0.5
    found, plain = np.empty((rows, 2)), np.empty((rows, 2))
    others = LineFollower(line_of(3))
    for row in range(rows):
        if row in (round(COMES_S / STEP_S), round(second_s / STEP_S)):
            change = 1.0 if row * STEP_S < second_s else -0.5
            follower.set_effect("splice", relative_change=change, length_m=LENGTH_M, time_s=0.0)
        x = [row * STEP_S * speed for speed in SPEEDS]
        for each, out in ((follower, found), (others, plain)):
            if row:
                each.follow(x, STEP_S)
            out[row] = each.tension_N
    expected = pieces([(COMES_S, 1.0), (second_s, -0.5)], rows)
    for k in (0, 1):
        size = np.abs(expected[:, k] - plain[:, k]).max()
        assert size > 5.0
        assert np.abs(found[:, k] - expected[:, k]).max() < 0.03 * size
    # Both are in span 2 at once, the second while the first is still in it.
    both = slice(round(1.3 / STEP_S), round(1.4 / STEP_S))
    alone = pieces([(second_s, -0.5)], rows)
    assert np.abs(found[both, 1] - alone[both, 1]).min() > 3.0


def test_pieces_beyond_what_is_kept_never_grow_the_state_and_those_that_left_are_forgotten() -> None:
    follower = LineFollower(line_of(3))
    plain, x = LineFollower(line_of(3)), 0.0
    size = len(follower.get_state().memory.state)  # type: ignore[attr-defined]
    for row in range(10_000):
        if row < 1000 and row % 40 == 0:
            follower.set_effect("splice", relative_change=0.5, length_m=0.05, time_s=0.0)
        if row == 1000:
            follower.clear_effect("splice")
        x += 0.002
        for each in (follower, plain):
            each.follow((x, x, x), 0.002)
    assert len(follower.get_state().memory.state) == size  # type: ignore[attr-defined]
    np.testing.assert_allclose(follower.tension_N, plain.tension_N, rtol=1e-6)
