"""Torsional shaft of a lone axis: what is right beside one, and from which frequency on none could be seen.

How it oscillates when a recording begins no recording says, so rows count once that has faded. And in a steady motion
friction that turns over late after each reversal is a torque that is late, as that of a shaft is: how friction turns
over is looked at again beside what oscillates.

A resonance is looked at with some frequencies; of one between them the search sees what the nearest explains, beside
all that was found and another inertia. Smooth motion hardly twists a shaft, and where it twists it slowly the twist
goes with the acceleration, as an inertia does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.measured_rules import is_in_known_band, least_share
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.selection import Selection
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import basis, without
from hilbench.diagnosis.terms import Place, Term, parts
from hilbench.plant.effect import Domain, ProbeOver

#: Lines of the spectrum by which a resonance has to be seen at least.
_LEAST_LINES: Final = 4.0
#: Time constants after which an oscillation has faded, and the share of a recording that is left out for it at most,
#: behind its beginning and its gaps.
_FADED: Final = 4.0
_MOST_FORGOTTEN: Final = 0.5
#: Share by which a sliding length is another.
_ANOTHER: Final = 0.1


def settled_beside(space: Space, found: Fit) -> OnMeasuredMotion | None:
    """Prediction in which friction turns over as it does beside what oscillates or goes round with the axis among the
    terms; None where that is as it was, or of a free run."""
    predictor, torsional = space.predictor, [term for term in found.terms if term.is_torsional]
    if not any(term.is_of_a_frequency for term in found.terms) or not isinstance(predictor, OnMeasuredMotion):
        return None
    derivatives = space.point(found.terms, found.residual).derivatives[:, 0]
    each = zip(found.terms, parts(found.terms), strict=True)
    beside = np.concatenate([derivatives[part] for term, part in each if term.is_of_a_frequency])
    most_s = _MOST_FORGOTTEN * space.duration_s / predictor.starts
    settled = predictor.settled_beside(beside, min(max(map(_memory_s, torsional), default=0.0), most_s))
    travels = [0.0 if one.presliding is None else one.presliding.presliding_travel for one in (predictor, settled)]
    return settled if torsional or abs(travels[1] - travels[0]) > _ANOTHER * max(travels) else None


def unidentifiable_modes(space: Space, found: Fit) -> list[Term]:
    """Torsional modes of which the motion has too few frequencies: share, frequency, damping and another inertia
    or friction may make up for each other in each of them."""
    rows, result = space.predictor.rows, []
    derivatives = space.point(found.terms, found.residual).derivatives
    for term, part in zip(found.terms, parts(found.terms), strict=True):
        # Rows are not cut out: the sine that goes on behind a gap with another phase would be another line.
        if term.is_torsional and _lines(np.where(rows, derivatives[part.start], 0.0)) < _LEAST_LINES:
            result.append(term)
    return result


def _lines(values: Array) -> float:
    """Into how many lines of equal size the spectrum of values (signals, n) would be divided: (Σp)² / Σp²."""
    power = np.abs(np.fft.rfft(values, axis=-1)) ** 2
    return float(np.sum(power) ** 2 / np.sum(power**2))


def _memory_s(term: Term) -> float:
    """Decay time of a resonance's free oscillation, s."""
    return _FADED / (2.0 * np.pi * term.values["frequency_Hz"] * term.values["damping"])


@dataclass(frozen=True)
class Unseen:
    """An effect at the lowest frequency at which its usual size could not be seen."""

    term: Term
    frequency_Hz: float
    smallest: float  #: strength that could be seen there; inf: none


def first_unseen(space: Space, proposer: Proposer, selection: Selection, deviations: float) -> Iterator[Unseen]:
    """First unseen frequency of each effect with one that neither model nor selection has; nothing of one that would be
    seen at all frequencies that are looked at.

    deviations: of the noise, from how many on something is seen.
    """
    known = {Place.of(entry) for entry in space.model.effects} | {term.place for term in selection.fit.terms}
    direct = proposer.direct()
    tried = [term for term in direct if _frequency(term) is not None and term.place not in known]
    for _, group in groupby(tried, lambda term: term.place):
        looked_at = sorted(group, key=_Hz)
        between = [
            replace(low, values={**low.values, _frequency(low) or "": float(np.sqrt(_Hz(low) * _Hz(high)))})
            for low, high in pairwise(looked_at)
        ]
        smallest = _smallest(space, selection, direct, looked_at, between, deviations)
        found = sorted(zip([*looked_at, *between], smallest, strict=True), key=lambda one: _Hz(one[0]))
        yield from [Unseen(term, _Hz(term), float(s)) for term, s in found if not s <= term.size][:1]


def _frequency(term: Term) -> str | None:
    """Name of the parameter that is the frequency with which a term is looked at."""
    probe = term.effect.probe
    return probe.parameter if probe is not None and probe.over is ProbeOver.FREQUENCIES else None


def _Hz(term: Term) -> float:
    return term.values[_frequency(term) or ""]


def _smallest(
    space: Space,
    selection: Selection,
    others: list[Term],
    looked_at: list[Term],
    between: list[Term],
    deviations: float,
) -> Array:
    """(looked at + between,): smallest strengths that a search sees, inf where it sees none.

    On measured motion they have to explain a share of what they leave unexplained, however large they are.
    """
    fit, rows, white = selection.fit, space.predictor.rows, selection.candidates.whitening
    others = [t for t in others if t.effect.domain is Domain.INERTIA and _frequency(t) is None]
    heavy = [t for t in others if not any(map(t.overlaps, fit.terms))]
    own = [space.point(fit.terms, fit.residual).derivatives, *space.strengths(fit.terms, fit.residual, heavy)]
    responses = np.concatenate(space.strengths(fit.terms, fit.residual, [*looked_at, *between]))
    beside, count = np.concatenate(own), len(looked_at)
    _, seen = _squares(white.apply(responses)[..., rows], white.apply(beside)[..., rows], count)
    smallest = deviations / np.sqrt(np.maximum(seen, 1e-300))
    if not space.predictor.exact:
        whole, seen = _squares(responses[..., rows], beside[..., rows], count)
        share = least_share(looked_at[0])
        left = share * float(np.sum(fit.residual[..., rows] ** 2))
        smallest = np.maximum(smallest, np.sqrt(left / np.maximum(seen - share * whole, 1e-300)))
    upper = looked_at[0].effect.parameter(looked_at[0].effect.strength[0]).upper
    known = [is_in_known_band(space, term) for term in [*looked_at, *between]]
    return np.where((smallest <= upper) & known, smallest, np.inf)


def _squares(responses: Array, beside: Array, tried: int) -> tuple[Array, Array]:
    """(J,) twice: squares of responses (J, signals, n) without what others have of them, and how much of those the best
    of the first so many explains."""
    flat = without(responses, basis(beside.reshape(len(beside), -1))).reshape(len(responses), -1)
    whole = np.maximum(np.sum(flat**2, axis=1), 1e-300)
    along = flat @ flat[:tried].T
    return whole, np.max(along**2 / whole[:tried], axis=1)
