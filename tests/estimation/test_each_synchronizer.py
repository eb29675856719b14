"""Each synchronizer alone, on samples of a roller and a web that are a formula: no plant, no twin, no bus."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hilbench.estimation.web_line.balance import BalanceSample
from hilbench.estimation.web_line.config import METHODS
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, Synchronizer, SyncSample
from hilbench.estimation.web_line.synchronizers.create import new_synchronizer

CYCLE_S, SPEED_M_S = 0.002, 3.0
SECTION_M2, LENGTH_M, PER_M, MASS_KG, NEXT_N = 0.5 * 65e-6, 1.0, 25.0, 30.0, 70.0
STRAIN, TORQUE_NOISE_NM = 2.8e-4, 0.05
START_PA, TRUE_PA = 8.7e9, 10.5e9
ON_BALANCE = [name for name in METHODS if name not in ("pid", "input")]


def new(name: str) -> Synchronizer:
    return new_synchronizer(METHODS[name](), Plant(START_PA, MASS_KG, PER_M, SECTION_M2, LENGTH_M))


def samples(
    seconds: float, *, strain: float = STRAIN, swing: float = 0.1, seed: int = 1, modulus_Pa: float = TRUE_PA
) -> Iterator[SyncSample]:
    """At constant speed the torque is the tension's, with noise; the strain swings by a share once in 2 s."""
    rng = np.random.default_rng(seed)
    for k in range(round(seconds / CYCLE_S)):
        h = SECTION_M2 * strain * (1.0 + swing * np.sin(np.pi * k * CYCLE_S))
        noise_Nm = TORQUE_NOISE_NM * rng.standard_normal()
        torque_Nm = (modulus_Pa * h - NEXT_N) / PER_M + noise_Nm
        yield SyncSample(
            cycle_s=CYCLE_S,
            torque_real_Nm=torque_Nm,
            torque_sim_Nm=(START_PA * h - NEXT_N) / PER_M,
            torque_sim_sensitivity_Nm_per_Pa=h / PER_M,
            upstream_strain=strain,
            balance=BalanceSample(SPEED_M_S * k * CYCLE_S, PER_M * torque_Nm + NEXT_N, h, SPEED_M_S),
        )


def after(synchronizer: Synchronizer, given: Iterator[SyncSample]) -> Estimate:
    estimate = None
    for sample in given:
        estimate = synchronizer.update(sample)
    assert estimate is not None
    return estimate


@pytest.mark.parametrize("name", ON_BALANCE)
def test_e_is_found_where_the_strain_moves_and_its_deviation_says_how_well(name: str) -> None:
    found = after(new(name), samples(4.0))
    assert found.youngs_modulus_Pa == pytest.approx(TRUE_PA, rel=0.01)
    assert 0.0 < found.deviation_Pa < 0.02 * TRUE_PA
    assert abs(found.youngs_modulus_Pa - TRUE_PA) < 5.0 * found.deviation_Pa


@pytest.mark.parametrize("name", ON_BALANCE)
def test_without_a_web_that_pulls_nothing_is_learned(name: str) -> None:
    """A slack web: the torque says nothing of E, however long it is looked at."""
    found = after(new(name), samples(1.0, strain=0.0))
    assert found.youngs_modulus_Pa == pytest.approx(START_PA, rel=1e-6)
    first = after(new(name), samples(2.0 * CYCLE_S, strain=0.0))
    assert found.deviation_Pa >= 0.99 * first.deviation_Pa


@pytest.mark.parametrize("name", METHODS)
def test_a_cycle_without_a_sample_leaves_the_estimate_and_is_less_sure_of_it(name: str) -> None:
    synchronizer = new(name)
    before = after(synchronizer, samples(1.0))
    later = before
    for _ in range(500):
        later = synchronizer.hold(CYCLE_S)
    assert later.youngs_modulus_Pa == pytest.approx(before.youngs_modulus_Pa, rel=1e-3)
    assert later.deviation_Pa >= before.deviation_Pa


@pytest.mark.parametrize("name", METHODS)
def test_equal_samples_give_equal_estimates(name: str) -> None:
    one, other = (after(new(name), samples(0.6, seed=3)) for _ in range(2))
    assert one == other


@pytest.mark.parametrize("name", METHODS)
def test_what_is_true_from_the_start_stays_as_it_is(name: str) -> None:
    found = after(new(name), samples(2.0, modulus_Pa=START_PA))
    assert found.youngs_modulus_Pa == pytest.approx(START_PA, rel=0.01)


def test_what_pulls_more_than_the_model_is_a_correction_of_the_strain_that_enters_a_black_box() -> None:
    """E is told as what would pull as much at the strain that the encoders show."""
    found = after(new("input"), samples(4.0, swing=0.0))
    assert found.youngs_modulus_Pa == pytest.approx(TRUE_PA, rel=0.01)
    assert found.upstream_strain is not None
    assert found.upstream_strain > 0.0
    less = after(new("input"), samples(4.0, swing=0.0, modulus_Pa=0.9 * START_PA))
    assert less.upstream_strain is not None
    assert less.upstream_strain < 0.0
