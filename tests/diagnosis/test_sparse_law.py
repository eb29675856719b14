"""Laws that are proposed for what no effect explains."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.diagnosis.residual_analysis import Condition
from hilbench.diagnosis.sparse_law import law, presliding

N = 6000
T = np.arange(N) * 0.005
X = 1.5 * np.sin(0.7 * T) + 0.8 * np.sin(2.1 * T + 0.4)
V = np.gradient(X, 0.005)
STATES = [
    Condition("time", "s", T, spectral=True),
    Condition("speed of axis 1", "m/s", V),
    Condition("acceleration of axis 1", "m/s²", np.gradient(V, 0.005)),
    Condition("position of axis 1", "m", X, spectral=True),
]
TEST = (np.arange(N) // 500) % 3 == 1


def proposed(residual: np.ndarray, noise: float = 0.05, seed: int = 0):  # type: ignore[no-untyped-def]
    noisy = residual + noise * np.random.default_rng(seed).standard_normal(N)
    return law("tau1_Nm", noisy, STATES, ~TEST, TEST)


def test_quadratic_drag_is_proposed_with_its_coefficient_and_unit() -> None:
    found = proposed(-0.3 * V * np.abs(V) + 0.2)
    assert [term.of for term in found.terms] == ["v·|v|"]
    assert found.terms[0].coefficient == pytest.approx(-0.3, rel=0.02)
    assert found.terms[0].unit == "N·m/(m/s)²"
    assert found.text == f"tau1 left = − {abs(found.terms[0].coefficient):.4g} N·m/(m/s)²·v·|v|"


def test_two_laws_at_once_are_both_proposed() -> None:
    found = proposed(0.4 * np.sin(2.0 * X) + 0.3 * np.abs(V))
    assert {term.of for term in found.terms} == {"sin(2·x/1 m)", "|v|"}
    assert found.share > 0.8


def test_friction_that_builds_up_over_a_way_is_proposed_as_presliding() -> None:
    presliding_travel = float(np.ptp(X))
    found = proposed(0.5 * (presliding(X, 0.03 * presliding_travel) - np.sign(V)))
    assert any(term.of.startswith("presliding over") for term in found.terms)


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_law(seed: int) -> None:
    assert proposed(np.zeros(N), seed=seed) is None


def test_what_depends_on_no_state_has_no_law_that_explains_most_of_it() -> None:
    found = proposed(np.where(T > 20.0, 0.2, 0.0))
    assert found is None or found.share < 0.3


def test_presliding_ends_at_coulomb_friction_in_either_direction() -> None:
    there_and_back = np.concatenate([np.linspace(0.0, 1.0, 200), np.linspace(1.0, 0.0, 200)])
    z = presliding(there_and_back, 0.05)
    assert z[199] == pytest.approx(1.0, abs=1e-6)
    assert z[-1] == pytest.approx(-1.0, abs=1e-6)
    assert np.all(np.abs(z) <= 1.0)
