"""Means of the balance over blocks, against the motion that made them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.estimation.web_line import block_means

MASS_KG, CYCLE_S, WEB = 30.0, 0.002, 2.8e-8


def blocks_of(accel_m_s2: float, tension_N: float, strange: int | None = None) -> list[tuple[float, float]]:
    """Force (N) and web (N/Pa) of blocks of a roller that accelerates evenly for 50 cycles; position `strange` is of
    an instant half a cycle later."""
    t_s = CYCLE_S * np.arange(50)
    x_m = 3.0 * t_s + 0.5 * accel_m_s2 * t_s**2
    if strange is not None:
        x_m[strange] += 0.5 * CYCLE_S * 3.0
    v_m_s = np.diff(x_m, prepend=2.0 * x_m[0] - x_m[1]) / CYCLE_S
    state, found = block_means.new_state(MASS_KG, CYCLE_S)[0], []
    for v in v_m_s:
        if block_means.take(state, tension_N + MASS_KG * accel_m_s2, WEB, v):
            found.append((state["force_N"], state["web_per_Pa"]))
    return found


@settings(deadline=None)
@given(accel=st.floats(-3.0, 3.0), tension=st.floats(-100.0, 500.0))
def test_a_block_is_the_force_without_what_accelerates_the_roller(accel: float, tension: float) -> None:
    found = blocks_of(accel, tension)
    assert len(found) == 5
    # The first speed is of no position before it.
    for force_N, web_per_Pa in found[1:]:
        assert force_N == pytest.approx(tension, abs=1e-6)
        assert web_per_Pa == pytest.approx(WEB)


@pytest.mark.parametrize("strange", range(20, 30))
def test_a_position_of_another_instant_hardly_shows(strange: int) -> None:
    forces = [force_N for force_N, _ in blocks_of(0.0, 80.0, strange)]
    assert forces == pytest.approx([80.0] * 5, abs=1e-6)


@pytest.mark.parametrize("collected", [0, 4])
def test_a_block_that_begins_behind_a_gap_lasts_since_then(collected: int) -> None:
    """By its duration the way of the web is counted: what is missing before it began is no part of it."""
    state = block_means.new_state(MASS_KG, CYCLE_S)[0]
    for _ in range(collected):
        block_means.take(state, 80.0, WEB, 3.0)
    block_means.begin_behind_gap(state)
    cycles = 1
    while not block_means.take(state, 80.0, WEB, 3.0):
        cycles += 1
    assert cycles == 1 + round(block_means.BLOCK_S / CYCLE_S)  # the first speed is one across the gap
    assert state["duration_s"] == pytest.approx(cycles * CYCLE_S)
