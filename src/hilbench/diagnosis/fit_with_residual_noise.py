"""Fits of terms where a right model would not leave noise alone, and how sure they are: what is left is the noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit, fit
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.noise import Whitening, rms, scaling
from hilbench.diagnosis.residual_analysis import Misfit
from hilbench.diagnosis.residual_noise import (
    Uncertainty,
    by_waves,
    uncertainty,
    with_doubts,
    with_guess,
    with_noisy_columns,
    with_shapes,
)
from hilbench.diagnosis.selection import Selection
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import StretchedProblem
from hilbench.diagnosis.terms import Term, parts
from hilbench.plant.effect import Domain
from hilbench.plant.effects import find_effect

#: Share of what is left from which a change with time explains too much of it for the effects to be all.
_MOSTLY: Final = 1.0 / 3.0
#: Rows of a while, and the share of what is left that a tenth of all whiles has where it comes in bursts.
_WHILE, _FEW, _BURSTS = 8, 10, 0.7
#: Share of the torque's rms from which what is left matters.
_MATTERS: Final = 0.01


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
    one steady sine by what repeats itself alone."""
    known, predictor = uncertainty_of(space, found), space.predictor
    if not isinstance(predictor, OnMeasuredMotion) or not found.terms:
        return known
    if predictor.sine_Hz is not None and not any(term.is_torsional for term in found.terms):
        return _on_one_sine(space, found, predictor, predictor.repeating(predictor.sine_Hz))
    rows = predictor.rows
    derivatives = space.point(found.terms, found.residual).derivatives[..., rows]
    left, doubts = found.residual[..., rows], predictor.doubts(space.packed(found.terms))[..., rows]
    known = with_shapes(known, derivatives, left, doubts[1:])  # an inertia is judged below
    if predictor.arm is None:
        if not any(map(_identifies_inertia, found.terms)):
            known = with_guess(known, derivatives, left, predictor.of_inertia[..., rows])
        return known
    alone = replace(space, predictor=predictor.uncoupled)
    beside = alone.point(found.terms, alone.residual(found.terms)).derivatives[:, 0]
    noisy, explained = predictor.by_accelerations(space.packed(found.terms))
    wide = np.concatenate([predictor.couplings, beside])[:, rows]
    return with_noisy_columns(known, wide, found.residual[0, rows], noisy[..., rows], explained[:, rows])


def lasting_change(space: Space, selection: Selection) -> Misfit | None:
    """What is left where much of it would be explained by friction and offset that change with time, as those of an
    axis that warms up do, or comes in bursts, as from a gear's play that is crossed; no effect does either."""
    rows, found, offered = space.predictor.rows, selection.fit, selection.candidates
    if rms(found.residual[..., rows]) < _MATTERS * rms(space.predictor.measured[..., rows]):
        return None
    own = space.point(found.terms, found.residual).derivatives[..., rows]
    mine = [own[part] for term, part in zip(found.terms, parts(found.terms), strict=True) if not term.effect.removable]
    each = zip(offered.candidates, offered.responses, strict=True)
    simple = np.concatenate([own[:0], *mine, *(r[..., rows] for term, r in each if not term.effect.removable)])
    problem = StretchedProblem.of(
        found.residual[..., rows], np.concatenate([own, simple, simple * np.linspace(-1.0, 1.0, simple.shape[-1])])
    )
    count = len(problem.raw)
    steady, changing = problem.left(list(range(count - len(simple))))[0], problem.left(list(range(count)))[0]
    share = 1.0 - changing / max(steady, 1e-300)
    name = space.predictor.names[0]
    if share > _MOSTLY:
        return Misfit(name, "time", "friction or offset change with it", share, _MOSTLY, "always")
    left = found.residual[0, rows]
    squares = np.sort([float(np.mean(part**2)) for part in np.array_split(left, max(len(left) // _WHILE, 1))])[::-1]
    few = float(np.sum(squares[: len(squares) // _FEW])) / max(float(np.sum(squares)), 1e-300)
    if few > _BURSTS:
        return Misfit(name, "burst in time", "what is left comes in bursts", few, _BURSTS, "always")
    return None


def _identifies_inertia(term: Term) -> bool:
    """True if an error of the model's inertia would show as another size of a term."""
    inertia = find_effect("inertia_mismatch")
    return term.effect.domain in (Domain.INERTIA, Domain.MOTOR_TORQUE) or term.effect.is_alike(inertia)


def _on_one_sine(space: Space, found: Fit, predictor: OnMeasuredMotion, waves: Array) -> Uncertainty:
    """Uncertainty on one sine, from its periodic part (waves, n) alone, and how friction turns over."""
    derivatives = space.point(found.terms, found.residual).derivatives
    shapes = predictor.doubt_of_turning(space.packed(found.terms))
    rows = predictor.rows
    return by_waves(derivatives[:, 0, rows], found.residual[0, rows], shapes[:, 0, rows], waves[:, rows])
