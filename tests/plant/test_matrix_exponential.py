"""The exponential of a matrix against scipy's, and against what is known of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from hilbench.plant.matrix_exponential import matrix_exponential


@pytest.mark.parametrize("size", [1e-9, 0.3, 5.0, 6.0, 80.0, 3e3])
def test_it_is_scipys(size: float) -> None:
    random = np.random.default_rng(7)
    for n in (1, 2, 5, 12):
        matrix = random.normal(size=(n, n))
        matrix *= size / np.linalg.norm(matrix, 1)
        matrix -= size * np.eye(n)  # nothing grows out of bounds
        found, expected = matrix_exponential(matrix), expm(matrix)
        assert np.max(np.abs(found - expected)) <= 1e-12 * max(1.0, size) * np.max(np.abs(expected))


def test_lags_and_integrators_of_very_different_times() -> None:
    """A position, a speed that a lagging force moves, and the force: known in closed form."""
    lag_s, mass_kg, time_s = 1e-6, 20.0, 5e-4
    rates = np.zeros((3, 3))
    rates[0, 1], rates[1, 2], rates[2, 2] = 1.0, 1.0 / mass_kg, -1.0 / lag_s
    left = np.exp(-time_s / lag_s)
    drawn_s = lag_s * (1.0 - left)
    expected = [
        [1.0, time_s, (lag_s * time_s - lag_s * drawn_s) / mass_kg],
        [0.0, 1.0, drawn_s / mass_kg],
        [0.0, 0.0, left],
    ]
    np.testing.assert_allclose(matrix_exponential(rates * time_s), expected, rtol=1e-11, atol=1e-18)


def test_nothing_gives_one() -> None:
    assert (matrix_exponential(np.zeros((3, 3))) == np.eye(3)).all()
    half_turn = np.pi * np.array([[0.0, -1.0], [1.0, 0.0]])
    np.testing.assert_allclose(matrix_exponential(half_turn), -np.eye(2), atol=1e-14)
