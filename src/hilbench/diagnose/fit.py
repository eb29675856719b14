"""Fitting chosen terms jointly: damped Gauss–Newton steps on whitened residuals, bounds kept, standard errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from hilbench.diagnose.noise import Whitening
from hilbench.diagnose.space import Point, Space
from hilbench.diagnose.terms import Term

Array = NDArray[np.float64]

_MOST_STEPS: Final = 6
_LEAST_STEPS: Final = 2
#: A step that promises less than this fall of the sum of squares is the last.
_ENOUGH: Final = 0.3
_FIRST_DAMPING: Final = 1e-4
#: Strengths, and steps between two of them, with which one is searched for.
_GRID: Final = 25
_SEARCH: Final = 12


@dataclass(frozen=True)
class Fit:
    """Fitted terms; sums of squares of whitened residuals on the rows of the fit and on the others."""

    terms: list[Term]
    residual: Array  #: raw, (signals, n)
    train: float
    test: float
    covariance: Array  #: of all coordinates, in the order of the terms


def sums(space: Space, white: Whitening, residual: Array) -> tuple[float, float]:
    """Sums of squares on training and held-out rows."""
    w = white.apply(residual)
    train, test = space.split.train, space.split.test
    return float(np.sum(w[:, train] ** 2)), float(np.sum(w[:, test] ** 2))


def fit(
    space: Space,
    white: Whitening,
    terms: list[Term],
    rows: NDArray[np.bool_] | None = None,
    worth: float = float("inf"),
) -> Fit:
    """Fit all coordinates of the terms from where they are, on `rows` (default: those that are not held out).

    Once the sum of squares does not promise to fall below `worth` the fit is left unfinished: it has lost.
    """
    rows = space.split.train if rows is None else rows
    damping = _FIRST_DAMPING
    point = space.point(terms)
    problem = _Problem(white, point, rows)
    if not problem.usable:  # where the linear guess has put it the model runs away
        return Fit(terms, point.residual, float("inf"), float("inf"), np.empty((0, 0)))
    for taken in range(_MOST_STEPS):
        step, promised = problem.step(damping)
        if promised < _ENOUGH or (taken >= _LEAST_STEPS and problem.square - promised > worth):
            break
        moved = _moved(point.terms, step)
        trial = space.residual(moved)
        if _Problem.square_of(white, trial, rows) < problem.square:
            damping = max(0.2 * damping, 1e-9)
            nearer = space.point(moved, trial)
            next_problem = _Problem(white, nearer, rows)
            if not next_problem.usable:
                break
            point, problem = nearer, next_problem
        else:
            damping = max(30.0 * damping, 1e-6)
            if damping > 1e6:
                break
    if problem.square <= worth and any(term.probe is not None for term in point.terms):
        point = space.point(_searched(space, white, point.terms, rows))
        problem = _Problem(white, point, rows)
    train, test = sums(space, white, point.residual)
    return Fit(point.terms, point.residual, train, test, problem.covariance())


def _searched(space: Space, white: Whitening, terms: list[Term], rows: NDArray[np.bool_]) -> list[Term]:
    """With strengths searched for where the sum of squares has many minima (that of a delay has)."""
    for place, term in enumerate(terms):
        if term.probe is not None:
            terms = _with_best_strength(space, white, terms, place, rows)
    return terms


def _with_best_strength(
    space: Space, white: Whitening, terms: list[Term], place: int, rows: NDArray[np.bool_]
) -> list[Term]:
    term = terms[place]
    middle, *shape = term.coordinates()

    def variant(strength: float) -> list[Term]:
        return [*terms[:place], term.at(np.array([strength, *shape])), *terms[place + 1 :]]

    def square(strength: float) -> float:
        return _Problem.square_of(white, space.residual(variant(strength)), rows)

    grid = np.linspace(0.0, 2.0 * middle + term.effect.parameter(term.effect.strength[0]).scale, _GRID)
    residuals = space.residuals([variant(float(strength)) for strength in grid])
    best = int(np.argmin([_Problem.square_of(white, residual, rows) for residual in residuals]))
    bounds = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _GRID - 1)]))
    found = minimize_scalar(square, bounds=bounds, method="bounded", options={"maxiter": _SEARCH, "xatol": 1e-6})
    return variant(float(found.x)) if found.fun < square(float(middle)) else terms


class _Problem:
    """The linearized problem at a point."""

    def __init__(self, white: Whitening, point: Point, rows: NDArray[np.bool_]) -> None:
        self._c = _flat(white.apply(point.derivatives)[:, :, rows])
        self._r = _flat(white.apply(point.residual)[None, :, rows])[0]
        self.square = float(self._r @ self._r)
        self._gram = self._c @ self._c.T
        self.usable = bool(np.isfinite(self.square) and np.all(np.isfinite(self._gram)))
        self._scale = np.sqrt(np.maximum(np.diag(self._gram), 1e-300))

    @staticmethod
    def square_of(white: Whitening, residual: Array, rows: NDArray[np.bool_]) -> float:
        """Sum of squares of raw residuals, whitened."""
        r = _flat(white.apply(residual)[None, :, rows])[0]
        return float(r @ r)

    def step(self, damping: float) -> tuple[Array, float]:
        """The damped step, and the fall of the sum of squares that it promises."""
        if len(self._c) == 0:
            return np.empty(0), 0.0
        normal = self._gram / np.outer(self._scale, self._scale)
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        normal += 1e-12 * np.eye(len(normal))
        step = np.linalg.solve(normal, self._c @ self._r / self._scale) / self._scale
        return step, float(2.0 * step @ (self._c @ self._r) - step @ self._gram @ step)

    def covariance(self) -> Array:
        """Of the coordinates; the whitened noise has variance 1."""
        if len(self._c) == 0:
            return np.empty((0, 0))
        normal = self._gram / np.outer(self._scale, self._scale)
        return np.asarray(np.linalg.pinv(normal, rcond=1e-12, hermitian=True) / np.outer(self._scale, self._scale))


def _flat(columns: Array) -> Array:
    """(count, signals, rows) as (count, signals·rows)."""
    return columns.reshape(len(columns), int(np.prod(columns.shape[1:])))


def _moved(terms: list[Term], step: Array) -> list[Term]:
    moved, at = [], 0
    for term in terms:
        here = term.coordinates()
        moved.append(term.at(here + step[at : at + len(here)]))
        at += len(here)
    return moved
