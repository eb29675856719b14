"""One model goes over into another: what is shown makes no step of its own, and does not lag."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from hilbench.twin.model_switch import BumplessTransfer

STEP_N, CYCLES = 0.4, 1500
SHARES = [way * way * (3.0 - 2.0 * way) for way in np.linspace(0.001, 0.999, CYCLES)]
AT = np.arange(CYCLES)


def shown(old_N: np.ndarray, new_N: np.ndarray) -> np.ndarray:
    smooth = BumplessTransfer([STEP_N, inf])
    rows = [smooth.show([old, 1.0], [new, 2.0], share)[0] for old, new, share in zip(old_N, new_N, SHARES, strict=True)]
    return np.array(rows)


def wanted(old_N: np.ndarray, new_N: np.ndarray) -> np.ndarray:
    return old_N + np.array(SHARES) * (new_N - old_N)


def test_a_difference_that_goes_round_with_a_roller_is_shown_as_it_is() -> None:
    old_N = np.full(CYCLES, 80.0)
    new_N = 80.0 + 8.0 * np.sin(2.0 * np.pi * 2.4 * 0.002 * AT)  # 30 µm out of true at 3 m/s
    assert np.array_equal(shown(old_N, new_N), wanted(old_N, new_N))


@pytest.mark.parametrize("jumps", ["old", "new"])
def test_a_jump_of_one_model_is_shown_as_a_slope_of_some_cycles(jumps: str) -> None:
    models = {"old": np.full(CYCLES, 80.0), "new": np.full(CYCLES, 82.0)}
    models[jumps][700:] += 2.6
    found = shown(**{f"{name}_N": tension_N for name, tension_N in models.items()})
    asked = wanted(models["old"], models["new"])
    assert np.abs(np.diff(asked)).max() > 1.0
    assert np.abs(np.diff(found)).max() <= STEP_N + 1e-9
    behind = np.flatnonzero(found != asked)
    assert behind[0] >= 700
    assert behind[-1] <= 710


def test_a_step_that_both_models_make_is_shown_at_once() -> None:
    old_N, new_N = np.full(CYCLES, 80.0), np.full(CYCLES, 82.0)
    for each, step_N in ((old_N, 16.0), (new_N, 16.3)):
        each[700:] += step_N
    found, asked = shown(old_N, new_N), wanted(old_N, new_N)
    assert np.abs(found - asked).max() < 0.3


def test_what_is_left_of_a_jump_at_the_end_goes_as_slowly() -> None:
    smooth = BumplessTransfer([STEP_N])
    before_N = smooth.show([80.0], [82.0], 0.999)[0]
    smooth.show([80.0], [88.0], 0.9995)
    assert not smooth.is_over
    found = [before_N]
    while not smooth.is_over:
        found.append(smooth.show([88.0], [88.0], 1.0)[0])
    assert found[-1] == 88.0
    assert np.abs(np.diff(found)).max() <= 2.0 * STEP_N + 1e-9
    assert len(found) < 20
