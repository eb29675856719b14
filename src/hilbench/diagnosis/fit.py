"""Fitting chosen terms jointly: damped Gauss–Newton steps on whitened residuals, bounds kept, standard errors.

Where a right model would not leave noise alone what is left is the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from hilbench.arrays import Array
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.noise import Whitening, scaling
from hilbench.diagnosis.residual_noise import (
    Uncertainty,
    by_waves,
    uncertainty,
    with_doubts,
    with_guess,
    with_noisy_columns,
    with_shapes,
)
from hilbench.diagnosis.space import Point, Space
from hilbench.diagnosis.terms import Term, parts, strength_parts
from hilbench.plant.effect import Domain
from hilbench.plant.effects import find_effect

_MOST_STEPS: Final = 6
_LEAST_STEPS: Final = 2
#: A step that promises less than this fall of the sum of squares is the last.
_ENOUGH: Final = 0.3
#: The same of a fit whose coordinates are stated, with intervals: a tenth of a standard error.
STATED: Final = 0.01
_FIRST_DAMPING: Final = 1e-4
#: Strengths, and steps between two of them, with which one is searched for.
_GRID: Final = 25
_SEARCH: Final = 12
#: How far from where it was proposed a time is looked for, and the steps of the first look, s: a step of E lets the web
#: ring at some 20 Hz, and each period of it is a minimum.
TIME_SEARCH: Final = (0.3, 0.01)
#: How often it is looked on from a better time; the minima, by the response at the last, that are simulated each time,
#: and how many steps the last search within a row takes.
_MOVES: Final = 5
_LIKELY, _CLOSEST = 4, 10
#: How much larger than looked for the rise of a sum of squares has to be by the response at another time to be larger.
_SURELY: Final = 10.0


@dataclass(frozen=True)
class Fit:
    """Fitted terms; sums of squares of whitened residuals on the rows of the fit and on the others."""

    terms: list[Term]
    residual: Array  #: raw, (signals, n)
    train: float
    test: float
    covariance: Array  #: (J, J) of all coordinates, in the order of the terms

    def wald(self, k: int) -> float:
        """Wald's statistic of the strength of term k against its neutral value."""
        part, moved = strength_parts(self.terms)[k], self.terms[k].moved
        return float(moved @ np.linalg.pinv(self.covariance[part, part]) @ moved)


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
    enough: float = _ENOUGH,
) -> Fit:
    """Fit all coordinates of the terms from where they are.

    space: recording and model; white: what makes the noise of its signals white; terms: with the values to start from.
    rows (n,): those to fit on, by default those that are not held out; then times that have been searched for stay,
    because what is held out may be where they are known from. worth: a sum of squares of the whitened residuals; once
    it does not promise to fall below that the fit is left unfinished: it has lost.

    Where the model runs away the sums of squares are infinite and the terms are those that were given.
    """
    timeless = rows is None
    rows = space.split.train if rows is None else rows
    point, problem = _descended(space, white, terms, rows, worth, timeless, enough)
    if not problem.usable:  # where the linear guess has put it the model runs away
        return Fit(terms, point.residual, float("inf"), float("inf"), np.empty((0, 0)))
    if problem.square <= worth and any(term.is_searched for term in point.terms):
        found = _searched(space, white, point.terms, rows)
        point, problem = _descended(space, white, found, rows, worth, timeless, enough)
    train, test = sums(space, white, point.residual)
    return Fit(point.terms, point.residual, train, test, problem.covariance())


def _descended(
    space: Space,
    white: Whitening,
    terms: list[Term],
    rows: NDArray[np.bool_],
    worth: float,
    timeless: bool,
    enough: float,
) -> tuple[Point, _Problem]:
    """The point where damped Gauss–Newton steps from the terms end, and the linearized problem there; as in `fit`."""
    damping, point = _FIRST_DAMPING, space.point(terms, timeless=timeless)
    problem = _Problem(white, point, rows)
    if not problem.usable:
        return point, problem
    for taken in range(_MOST_STEPS):
        step, promised = problem.step(damping)
        if promised < enough or (taken >= _LEAST_STEPS and problem.square - promised > worth):
            break
        pairs = zip(point.terms, parts(point.terms), strict=True)
        moved = [term.at(term.coordinates() + step[part]) for term, part in pairs]
        nearer = space.point(moved, timeless=timeless)  # at once, on all cores: nearly every step is an improvement
        if _Problem.square_of(white, nearer.residual, rows) < problem.square:
            damping = max(0.2 * damping, 1e-9)
            next_problem = _Problem(white, nearer, rows)
            if not next_problem.usable:
                break
            point, problem = nearer, next_problem
        else:
            damping = max(30.0 * damping, 1e-6)
            if damping > 1e6:
                break
    return point, problem


def _searched(space: Space, white: Whitening, terms: list[Term], rows: NDArray[np.bool_]) -> list[Term]:
    """The terms with delays and times, in which the sum of squares has many minima, put where it is least.

    A time is looked for on all rows: when something happened is only known where it happened.
    """
    for place, term in enumerate(terms):
        if term.probe is not None:
            terms = _with_best_strength(space, white, terms, place, rows)
        elif term.is_searched:
            terms = with_best_time(space, white, terms, place)
    return terms


@dataclass(frozen=True)
class OnsetResponses:
    """Responses of what sets in at once at some times, from which those at other times follow: what lasts begins there,
    and what passes moves along, as it does in a machine that runs on as before."""

    times_s: Array  #: (T,)
    responses: Array  #: (T, signals, n)
    always: Array  #: (signals, n): of what has been there from the beginning
    row_s: float

    def at(self, time_s: float) -> Array:
        """Response (signals, n) of what sets in at a time, to the nearest row."""
        nearest = int(np.argmin(np.abs(self.times_s - time_s)))
        n = self.always.shape[-1]
        first = min(int(np.ceil(self.times_s[nearest] / self.row_s)), n)
        shift = int(np.clip(round((time_s - float(self.times_s[nearest])) / self.row_s), -n, n))
        passing: Array = self.responses[nearest].copy()
        passing[:, first:] -= self.always[:, first:]
        found = np.zeros_like(passing)
        found[:, max(shift, 0) : n + min(shift, 0)] = passing[:, max(-shift, 0) : n - max(shift, 0)]
        start = max(first + shift, 0)
        found[:, start:] += self.always[:, start:]
        return found


class TimeSearch:
    """The sum of squares by the time of the term at `place`, its strength fitted to each, the other terms as they are,
    on all rows that count."""

    def __init__(self, space: Space, white: Whitening, terms: list[Term], place: int) -> None:
        self._space, self._white, self._terms, self._place = space, white, terms, place
        term = terms[place]
        neutral, always = space.residuals([self._with(term.neutral()), self._with(term.moved_to(0.0))])
        self._neutral, self._always = neutral, neutral - always
        self._without = self._counted(neutral)
        self._known: dict[float, Array] = {}

    def _with(self, term: Term) -> list[Term]:
        return [*self._terms[: self._place], term, *self._terms[self._place + 1 :]]

    def _counted(self, values: Array) -> Array:
        return np.asarray(self._white.apply(values)[:, self._space.predictor.rows].ravel())

    def _square(self, response: Array) -> tuple[float, float]:
        whitened = self._counted(response)
        along, square = float(whitened @ self._without), float(whitened @ whitened)
        scale = along / max(square, 1e-300)
        return float(self._without @ self._without) - along * scale, scale

    def exactly(self, times_s: Array) -> tuple[Array, Array]:
        """Sums of squares (T,), and by which factors (T,) of the strength."""
        term = self._terms[self._place]
        new = [float(time) for time in times_s if float(time) not in self._known]
        if new:
            residuals = self._space.residuals([self._with(term.moved_to(time)) for time in new])
            self._known |= dict(zip(new, self._neutral - residuals, strict=True))
        squares, scales = zip(*(self._square(self._known[float(time)]) for time in times_s), strict=True)
        return np.array(squares), np.array(scales)

    def nearly(self, times_s: Array, known_s: float) -> Array:
        """Sums of squares (T,), to the nearest row, from the response at a time near them."""
        self.exactly(np.array([known_s]))
        row_s = self._space.period_s * self._space.predictor.every
        known = OnsetResponses(np.array([known_s]), self._known[known_s][None], self._always, row_s)
        return np.array([self._square(known.at(float(time)))[0] for time in times_s])


def with_best_time(space: Space, white: Whitening, terms: list[Term], place: int) -> list[Term]:
    """The term at `place` put at the time near its own at which it explains most, with the strength for it."""
    term = terms[place]
    search, here, half_step_s = TimeSearch(space, white, terms, place), term.time_s, 0.5 * space.period_s
    for half_s, step_s in (TIME_SEARCH, (TIME_SEARCH[1], half_step_s)):
        for _ in range(_MOVES):
            times = around(here, half_s, step_s)
            tried = np.append(times[_lowest(search.nearly(times, here))], here)
            best = float(tried[int(np.argmin(search.exactly(tried)[0]))])
            if best == here:
                break
            here = best
    found = minimize_scalar(
        lambda time: float(search.exactly(np.array([time]))[0][0]),
        bounds=(max(here - half_step_s, 0.0), here + half_step_s),
        method="bounded",
        options={"maxiter": _CLOSEST, "xatol": 0.05 * space.period_s},
    )
    tried = np.array([here, float(found.x)])
    squares, scales = search.exactly(tried)
    best = int(np.argmin(squares))
    term, scale = term.moved_to(float(tried[best])), float(scales[best])
    strength = scale * term.coordinates()[:1]
    aimed = term.of_strength(strength) if term.allowed(float(strength[0])) else term
    return [*terms[:place], replace(aimed, aimed=True), *terms[place + 1 :]]


def _lowest(squares: Array) -> Array:
    """Places of the lowest minima."""
    padded = np.concatenate([[np.inf], squares, [np.inf]])
    minima = np.flatnonzero((squares <= padded[:-2]) & (squares <= padded[2:]))
    return np.asarray(minima[np.argsort(squares[minima], kind="stable")][:_LIKELY])


def time_interval_s(
    space: Space, white: Whitening, terms: list[Term], place: int, times_s: Array, rise: float
) -> tuple[float, float]:
    """The times among times_s (T,) up to which the sum of squares is within `rise` of its least; those next to them."""
    search, here = TimeSearch(space, white, terms, place), terms[place].time_s
    nearly = search.nearly(times_s, here)
    near = np.abs(times_s - here) <= 2.0 * space.period_s * space.predictor.every
    likely = near | (nearly <= np.min(nearly) + _SURELY * rise)
    squares = np.full(len(times_s), np.inf)
    squares[likely] = search.exactly(times_s[likely])[0]
    within = np.flatnonzero(squares <= np.min(squares) + rise)
    first, last = max(int(within[0]) - 1, 0), min(int(within[-1]) + 1, len(times_s) - 1)
    return float(times_s[first]), float(times_s[last])


def around(time_s: float, half_s: float, step_s: float) -> Array:
    """Times from `half_s` before to `half_s` after a time, none below zero."""
    count = int(np.ceil(half_s / step_s - 1e-9))
    return np.unique(np.maximum(time_s + step_s * np.arange(-count, count + 1), 0.0))


def _with_best_strength(
    space: Space, white: Whitening, terms: list[Term], place: int, rows: NDArray[np.bool_]
) -> list[Term]:
    term = terms[place]
    middle = float(term.coordinates()[0])

    def variant(strength: float) -> list[Term]:
        return [*terms[:place], term.of_strength(np.array([strength])), *terms[place + 1 :]]

    def square(strength: float) -> float:
        return _Problem.square_of(white, space.residual(variant(strength)), rows)

    grid = np.linspace(0.0, 2.0 * middle + term.size, _GRID)
    residuals = space.residuals([variant(float(strength)) for strength in grid])
    best = int(np.argmin([_Problem.square_of(white, residual, rows) for residual in residuals]))
    bounds = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _GRID - 1)]))
    found = minimize_scalar(square, bounds=bounds, method="bounded", options={"maxiter": _SEARCH, "xatol": 1e-6})
    return variant(float(found.x)) if found.fun < square(middle) else terms


def moved_by_doubts(space: Space, white: Whitening, found: Fit) -> Array:
    """(J, shapes): by how much each coordinate of a fit to all rows is off, to one standard deviation, because a right
    prediction may be off by more than noise: what least squares makes of each such shape."""
    doubts = space.doubts(found.terms)
    if not len(doubts) or not len(found.covariance):
        return np.zeros((len(found.covariance), 0))
    rows = space.predictor.rows
    columns = _flat(white.apply(space.point(found.terms, found.residual).derivatives)[:, :, rows])
    return np.asarray(found.covariance @ columns @ _flat(white.apply(doubts)[:, :, rows]).T)


def fitted(space: Space, terms: list[Term]) -> Fit:
    """The terms fitted to all rows that count, every frequency of the band with the same weight."""
    return fit(space, weights(space, terms), terms, space.predictor.rows)


def weights(space: Space, terms: list[Term]) -> Whitening:
    """Scale each signal by the rms residual of a model with the terms."""
    residual = space.residual(terms)[:, space.predictor.rows]
    return scaling(np.maximum(np.std(residual, axis=-1), 1e-300))


def uncertainty_of(space: Space, found: Fit, rows: NDArray[np.bool_] | None = None) -> Uncertainty:
    """Uncertainty of a fit's coordinates, with its residual as noise; rows (n,) of the fit, by default all that count.

    A resonance is identified by few frequencies, at which slightly different friction or inertia look alike: there it
    counts by what the prediction may be off.
    """
    rows = space.predictor.rows if rows is None else rows
    derivatives = space.point(found.terms, found.residual).derivatives[..., rows]
    known = uncertainty(derivatives, found.residual[..., rows])
    doubted = np.concatenate([np.zeros(0, bool), *(np.full(len(t.coordinates()), t.is_torsional) for t in found.terms)])
    if not np.any(doubted):
        return known
    return with_doubts(known, derivatives, found.residual[..., rows], space.doubts(found.terms)[..., rows], doubted)


def stated_uncertainty(space: Space, found: Fit) -> Uncertainty:
    """Uncertainty of a fit, also by an inertia of the model that is a guess, where no term says how far it is off, and
    by noise in the accelerations of coupled axes: it hardly shows in them, and their columns are nearly collinear. On
    one steady sine by what repeats itself alone, and how friction turns over."""
    known, predictor = uncertainty_of(space, found), space.predictor
    if not isinstance(predictor, OnMeasuredMotion) or not found.terms:
        return known
    rows, parameters = predictor.rows, space.packed(found.terms)
    derivatives, left = space.point(found.terms, found.residual).derivatives[..., rows], found.residual[..., rows]
    if predictor.sine_Hz is not None and not any(term.is_torsional for term in found.terms):
        turning, waves = predictor.doubt_of_turning(parameters), predictor.repeating(predictor.sine_Hz)
        return by_waves(derivatives[:, 0], left[0], turning[:, 0, rows], waves[:, rows])
    known = with_shapes(known, derivatives, left, predictor.doubts(parameters)[1:, :, rows])  # an inertia: below
    if predictor.arm is None:
        inertia, of_all = find_effect("inertia_mismatch"), (Domain.INERTIA, Domain.MOTOR_TORQUE)
        # An error of the model's inertia would show as another size of one of these.
        if not any(term.effect.domain in of_all or term.effect.is_alike(inertia) for term in found.terms):
            known = with_guess(known, derivatives, left, predictor.of_inertia[..., rows])
        return known
    alone = replace(space, predictor=predictor.uncoupled)
    beside = alone.point(found.terms, alone.residual(found.terms)).derivatives[:, 0]
    noisy, explained = predictor.by_accelerations(parameters)
    wide = np.concatenate([predictor.couplings, beside])[:, rows]
    return with_noisy_columns(known, wide, left[0], noisy[..., rows], explained[:, rows])


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
        """Covariance of the coordinates; the whitened noise has variance 1."""
        return inverse_of(self._gram) if len(self._c) else np.empty((0, 0))


def inverse_of(gram: Array) -> Array:
    """Pseudo-inverse of a Gram matrix (J, J) of columns of any units."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    sizes = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(gram / sizes, rcond=1e-12, hermitian=True) / sizes)


def _flat(columns: Array) -> Array:
    """(count, signals, rows) as (count, signals·rows)."""
    return columns.reshape(len(columns), int(np.prod(columns.shape[1:])))
