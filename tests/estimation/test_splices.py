"""Other web that enters a span, separated from what a ramp of the speed shows in the balance."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.estimation.web_line.balance import BalanceSample
from hilbench.estimation.web_line.splices import Entered, SpliceFinder

CYCLE_S, RAMP_S, SPEED_M_S = 0.005, 6.0, 3.0
#: Lag of the drives' speed.
LAG_S = 0.03
MODULUS_PA, TENSION_N, MASS_KG = 1e9, 180.0, 300.0
#: Of a speed from the difference of two positions, m/s: 3 % of the ramp's acceleration in a block.
SPEED_NOISE_M_S = 1.5e-4


def found(
    seed: int, length_m: float, mass_error: float = 0.0, enters_s: float = np.inf, change: float = 0.0
) -> list[Entered]:
    """What is found in a span of this length until 2 s after a ramp; `mass_error`: of the true roller's mass; at
    `enters_s` web of another E enters."""
    rng = np.random.default_rng(seed)
    finder = SpliceFinder(length_m, MASS_KG, CYCLE_S)
    entered, before_m, speed_m_s = list[Entered](), 0.0, 0.0
    for t_s in np.arange(0.0, RAMP_S + 2.0, CYCLE_S):
        accel_m_s2 = (min(SPEED_M_S * t_s / RAMP_S, SPEED_M_S) - speed_m_s) / LAG_S
        speed_m_s += accel_m_s2 * CYCLE_S
        before_m += speed_m_s * CYCLE_S
        travel = max(t_s - enters_s, 0.0) * speed_m_s / length_m
        compliance = (1.0 + (1.0 / (1.0 + change) - 1.0) * (1.0 - np.exp(-travel))) / MODULUS_PA
        force_N = TENSION_N + (1.0 + mass_error) * MASS_KG * accel_m_s2 + rng.normal(0.0, 0.3)
        measured_m_s = speed_m_s + rng.normal(0.0, SPEED_NOISE_M_S)
        now = BalanceSample(before_m, force_N, compliance * TENSION_N, measured_m_s)
        result = finder.update(now, before_m, 1.0)
        if result is not None:
            entered.append(result)
    return entered


@pytest.mark.parametrize("mass_error", [0.0, 0.05, -0.05])
def test_the_end_of_a_ramp_is_no_other_web(mass_error: float) -> None:
    for seed in range(8):
        assert found(seed, 0.45, mass_error) == []


@pytest.mark.parametrize("mass_error", [0.0, 0.05])
@pytest.mark.parametrize("change", [0.2, -0.2])
def test_other_web_soon_after_a_ramp_is_found(change: float, mass_error: float) -> None:
    for seed in (1, 2):
        joint = found(seed, 3.0, mass_error, enters_s=RAMP_S + 0.3, change=change)[-1].joint
        assert joint is not None
        assert joint.relative_change == pytest.approx(change, abs=0.04)
