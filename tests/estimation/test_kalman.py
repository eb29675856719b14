"""The compiled filter against the textbook's matrices, and against least squares."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.estimation.bank import BankArrays, new_bank
from hilbench.estimation.motion_filter import RATE, V, X, new_filter
from hilbench.estimation.web_line.config import AlsoEstimated, EkfConfig
from hilbench.estimation.web_line.synchronizers import kalman

DT_S, MASS_KG, RATIO, FORCE_SD_N, POSITION_SD_M = 0.002, 30.0, 25.0, 1.25, 7e-8


def inputs(offset_prior: float) -> np.void:
    u = kalman.new_inputs(np.array([offset_prior, 0.0, 0.0, 0.0]), MASS_KG, RATIO)[0]
    u["duration_s"] = DT_S
    u["force_variance"], u["position_variance"] = FORCE_SD_N**2, POSITION_SD_M**2
    u["parameter_variance_per_s"] = 1e-6
    return u


def two_filters(priors: list[float]) -> BankArrays:
    """Two equal filters beside each other, E within 20 %."""
    places = np.array([*range(kalman.OFFSET), *(np.flatnonzero(priors) + kalman.OFFSET)])
    bank = new_bank(kalman.SIZE, places, 0.0, 0.0, capacity=2)
    for i in range(2):
        new_filter(bank, i, 0.2, np.array(priors))
    return bank


def joseph(z: np.ndarray, p: np.ndarray, u: np.void) -> tuple[np.ndarray, np.ndarray]:
    """One cycle with matrices and Joseph's form; nothing in common with the compiled code but the state's order."""
    k = kalman
    g = np.zeros(k.SIZE)
    g[k.E], g[k.OFFSET] = -u["web_N"] / MASS_KG, -RATIO / MASS_KG
    g[k.VISCOUS], g[k.DRY] = -u["speed_m_s"] / MASS_KG, -np.sign(u["speed_m_s"]) / MASS_KG
    g[k.MASS] = -u["acceleration_m_s2"]
    into = np.zeros(k.SIZE)
    into[X], into[V] = DT_S**2 / 2.0, DT_S
    f = np.eye(k.SIZE) + np.outer(into, g)
    f[X, V] += DT_S
    f[k.E, RATE] += DT_S
    z = f @ z + into * u["force_N"] / MASS_KG
    p = f @ p @ f.T + np.outer(into, into) * u["force_variance"] / MASS_KG**2
    p[k.E, k.E] += DT_S * u["parameter_variance_per_s"]
    gain = p[:, X] / (p[X, X] + u["position_variance"])
    rest = np.eye(k.SIZE)
    rest[:, X] -= gain
    innovation = u["position"] - z[X]
    return z + gain * innovation, rest @ p @ rest.T + np.outer(gain, gain) * u["position_variance"]


def test_a_hundred_steps_agree_with_josephs_form() -> None:
    rng = np.random.default_rng(1)
    filters = two_filters([0.05, 0.5, 1.0, 0.01])
    z, p, *_ = filters
    p[RATE, RATE] = 1e-4
    expected = z[:, 0].copy(), p[:, :, 0].copy()
    u = inputs(0.0)
    for _ in range(100):
        u["force_N"], u["web_N"] = rng.normal(90.0, 5.0), rng.normal(80.0, 5.0)
        u["speed_m_s"], u["acceleration_m_s2"] = rng.normal(0.0, 3.0), rng.normal(0.0, 1.0)
        u["position"] = rng.normal(0.0, 1e-4)
        kalman.step(filters, u)
        expected = joseph(*expected, u)
    scale = np.sqrt(np.diag(expected[1]))
    for i in range(2):
        assert z[:, i] == pytest.approx(expected[0], rel=1e-6, abs=1e-9)
        assert np.max(np.abs(p[:, :, i] - expected[1]) / np.outer(scale, scale)) < 1e-6


def test_offset_and_e_come_out_as_least_squares_says() -> None:
    rng = np.random.default_rng(0)
    n, prior = 4000, 0.05
    web_N = np.linspace(76.0, 99.0, n)
    force_N = 1.2 * web_N + RATIO * 0.04 + FORCE_SD_N * rng.standard_normal(n)
    filters = two_filters([prior, 0.0, 0.0, 0.0])
    z, p, *_ = filters
    u = inputs(prior)
    u["parameter_variance_per_s"] = 0.0
    for force, web in zip(force_N, web_N, strict=True):
        u["force_N"], u["web_N"] = force, web
        u["position"] = POSITION_SD_M * rng.standard_normal()
        kalman.step(filters, u)
    # The filter sees forces through positions and lets the offset wander a little: it knows a little less.
    rows = np.column_stack([web_N, np.full(n, RATIO)]) / FORCE_SD_N
    covariance = np.linalg.inv(rows.T @ rows + np.diag([1.0 / 0.2**2, 1.0 / prior**2]))
    solution = covariance @ (rows.T @ (force_N / FORCE_SD_N) + np.array([1.0 / 0.2**2, 0.0]))
    found, deviations = z[[kalman.E, kalman.OFFSET], 0], np.sqrt(np.diag(p[:, :, 0]))[[kalman.E, kalman.OFFSET]]
    assert deviations == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.15)
    assert np.abs(found - solution) == pytest.approx([0.0, 0.0], abs=0.5 * float(np.max(deviations)))


def test_the_prior_of_what_is_estimated_beside_e_is_in_the_filters_order() -> None:
    also = AlsoEstimated(torque_offset_Nm=1.0, viscous_friction_N_s_per_m=2.0, dry_friction_N=3.0, inertia_share=4.0)
    assert [value for _, value in EkfConfig(also=also).also] == [1.0, 2.0, 3.0, 4.0]
    assert list(kalman.NUISANCES) == [kalman.OFFSET, kalman.VISCOUS, kalman.DRY, kalman.MASS]
