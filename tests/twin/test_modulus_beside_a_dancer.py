"""A step of E of the web beside a dancer changes no tension for long: it is told by its kick, and no other E is.

The line is one of equations of its own; E of the dancer's section is told by what it does to the one behind: strain
that comes in from there is no other E.
"""

from __future__ import annotations

import numpy as np
import pytest
from tests.tiers import slow
from tests.twin.beside_stations import Array, BesideStations, dancer_line
from tests.twin.independent_dancer import IndependentDancer

from hilbench.estimation.problems import Problem

_MODULUS_PA = 8.7e9
_BEFORE_S = 2.0
_BESIDE_THE_DANCER, _BEHIND = np.array([True, True, False, False]), np.array([False, False, True, True])


def beside_the_dancer(speed_m_s: float, seed: int = 1) -> tuple[BesideStations, IndependentDancer]:
    """The twin beside that line, at that speed."""
    true = IndependentDancer()
    line = BesideStations(true, dancer_line(), dancer_line(), seed=seed)  # type: ignore[arg-type]
    line.go(1.0, *[speed_m_s] * 3, ramp_s=0.8)
    line.go(_BEFORE_S, *[speed_m_s] * 3)
    return line, true


def off(found: dict[str, Array], modulus_Pa: float, after_s: float) -> float:
    """Largest error of E behind the dancer's section from so long after the step on, as a share."""
    late = found["t_s"] > _BEFORE_S + after_s
    return float(np.max(np.abs(found["E4_sim_Pa"] / modulus_Pa - 1.0)[late]))


@pytest.mark.parametrize(
    ("factor", "speed_m_s", "seed"),
    [(1.2, 2.0, 1), *slow((0.8, 1.0, 2), (0.85, 2.0, 3), (1.15, 1.0, 1), (1.5, 2.0, 2))],
)
def test_a_step_of_E_beside_a_dancer_is_no_other_E_behind_it(factor: float, speed_m_s: float, seed: int) -> None:
    line, true = beside_the_dancer(speed_m_s, seed)
    true.modulus_Pa = np.where(_BESIDE_THE_DANCER, factor * _MODULUS_PA, _MODULUS_PA)
    line.go(_BEFORE_S + 2.5, *[speed_m_s] * 3)
    found = line.table()
    assert off(found, _MODULUS_PA, 0.3) < 0.015
    assert np.all(np.isfinite(found["E4_sd_Pa"]))
    late = found["t_s"] > _BEFORE_S + 0.5
    assert np.max(np.abs(found["F4_sim_N"] - found["F4_true_N"])[late]) < 1.0
    # Another strain came in with it, which the tension has followed.
    assert np.ptp(found["F4_true_N"]) > 5.0


@pytest.mark.parametrize("factor", [1.2, *slow(0.7)])
def test_a_step_of_E_behind_it_is_no_kick(factor: float) -> None:
    line, true = beside_the_dancer(2.0)
    true.modulus_Pa = np.where(_BEHIND, factor * _MODULUS_PA, _MODULUS_PA)
    line.go(_BEFORE_S + 1.5, 2.0, 2.0, 2.0)
    found = line.table()
    assert off(found, factor * _MODULUS_PA, 0.5) < 0.015
    assert np.all(np.isfinite(found["E4_sd_Pa"]))


def test_E_that_may_be_a_slip_is_not_told_until_it_is() -> None:
    line, true = beside_the_dancer(2.0)
    true.slip = np.array([0.0, 0.0, 0.0, 0.0, 4e-5])
    line.go(_BEFORE_S + 0.6, 2.0, 2.0, 2.0)
    assert np.isinf(line.table()["E4_sd_Pa"][-1])
    assert not line.twin.separable
    while line.time_s < _BEFORE_S + 5.0 and line.twin.problem is None:
        line.go(line.time_s + 0.02, 2.0, 2.0, 2.0)
    assert line.twin.problem is Problem.SLIP
    line.go(line.time_s + 0.1, 2.0, 2.0, 2.0)
    found = line.table()
    assert found["E4_sim_Pa"][-1] == pytest.approx(_MODULUS_PA, rel=0.01)
    assert found["E4_sd_Pa"][-1] < 0.05 * _MODULUS_PA
