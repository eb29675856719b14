"""Rules of a search on measured motion: terms offered first, not distinguishable by the motion, of one size only here.

An effect has one size. A substitute for something else has another wherever that is another: in other frequency bands,
and in other stretches of a recording.

One steady sine of a lone axis passes each place with one speed and one acceleration. There what grows with the size of
the speed goes with the position, as a ripple of an order that a short arc does not tell does; and what is late, or goes
with the load, is friction that turns over a displacement, or grows with the speed. Of the laws that are no simpler than
these nothing is offered of which they leave little.

How a torsional shaft oscillates when a recording begins no recording says, so rows count once that has faded. And in a
steady motion friction that turns over late after each reversal is a torque that is late, as that of a shaft is: how
friction turns over is looked at again beside what oscillates. A resonance is looked at with some frequencies; of one
between them the search sees what the nearest explains, beside all that was found and another inertia. Smooth motion
hardly twists a shaft, and where it twists it slowly the twist goes with the acceleration, as an inertia does.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit, fit, fitted, uncertainty_of, weights
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.noise import rms
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_analysis import Misfit
from hilbench.diagnosis.residual_noise import Uncertainty
from hilbench.diagnosis.selection import CandidateSet, Selection
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import STRETCHES, StretchedProblem, basis, own_share, without
from hilbench.diagnosis.terms import RANK, Place, Term, parts, strength_parts
from hilbench.plant.effect import Domain, ProbeOver

#: Share of the sum of squares that is left without a term by which the term has to lower it, half of it on stretches
#: that no fit has seen; the same of a simple effect, without which no other is read aright.
LEAST_SHARE, _LEAST_SIMPLE_SHARE = 0.06, 0.01
#: Share of what is left by which two explanations may differ and be tied, and by which one has to be better.
TIED: Final = 0.03
#: Ratio from which one of two tied explanations is clearly more its own, or less unusual.
_CLEARLY: Final = 1.5
#: Share of what any order explains from which a whole one is named instead.
WHOLE: Final = 0.75
#: Share of what is left from which a change with time explains too much of it for the effects to be all.
_MOSTLY: Final = 1.0 / 3.0
#: Rows of a while, and the share of what is left that a tenth of all whiles has where it comes in bursts.
_WHILE, _FEW, _BURSTS = 8, 10, 0.7
#: Share of the torque's rms from which what is left matters.
_MATTERS: Final = 0.01


@dataclass(frozen=True)
class Offer:
    """A term that may be added, with its start values."""

    term: Term
    left: float  #: sum of squares, with it
    own: float  #: share of its response that the present terms leave of it
    in_stretches: float  #: of a wave: what it explains with a phase of its own in every stretch

    @property
    def sizes(self) -> float:
        """Distance from neutral, in units of the term's usual size."""
        return float(np.linalg.norm(self.term.moved)) / self.term.size


def in_order(offers: list[Offer], as_simple: Collection[str] = ()) -> list[Offer]:
    """The simple first, then what leaves least; of those that leave the same, what is named first.

    as_simple: effects that are as simple in this recording.
    """
    waiting = sorted(
        offers, key=lambda offer: (offer.term.effect.removable and offer.term.effect.id not in as_simple, offer.left)
    )
    ordered = []
    while waiting:
        first = waiting[0]
        for other in waiting[1:]:
            if other.left <= (1.0 + TIED) * waiting[0].left and _is_preferred(other, first):
                first = other
        waiting.remove(first)
        ordered.append(first)
    return ordered


def _is_preferred(other: Offer, offer: Offer) -> bool:
    """True if another explanation that leaves as much is preferred.

    The simple one; then the one that changes less of what the present terms explain; then the one that is less unusual
    on such a machine; then the first in the table.
    """
    if other.term.effect.removable != offer.term.effect.removable:
        return not other.term.effect.removable
    for mine, its in ((offer.own, other.own), (1.0 / offer.sizes, 1.0 / other.sizes)):
        if max(mine, its) > _CLEARLY * min(mine, its):
            return its > mine
    return RANK[other.term.effect.id] < RANK[offer.term.effect.id]


def is_beside_a_whole_order(offer: Offer, whole: list[tuple[Term, float]]) -> bool:
    """True if a whole order explains nearly as much as this one that is not.

    whole: terms of whole orders, and what each explains with a phase of its own in every stretch, even if with one
    phase it explains too little to be offered: then an order near it is not offered either.
    """
    return not offer.term.held and any(
        other.key == offer.term.key and explained >= WHOLE * offer.in_stretches for other, explained in whole
    )


def least_share(term: Term) -> float:
    return LEAST_SHARE if term.effect.removable else _LEAST_SIMPLE_SHARE


#: Chance up to which a term that is neutral may be found all the same, over all places that it was searched for at.
CHANCE: Final = 1e-3
#: Standard deviations by which what a narrower band finds may differ.
_APART: Final = 3.5
#: Share of a strength by which two bands or stretches may differ however sure they are: a filter rounds what turns.
_SAME_SIZE: Final = 0.03


def in_every_band(space: Space, current: Fit) -> Fit:
    """The fit without the terms of which a narrower band finds another size, one by one, what explains least first:
    beside a substitute for something else the others have another size as well.

    An effect has one size; a substitute for something else (a delay for a loop's answer to a ripple) changes with
    the frequencies that are looked at. A wave shows in a narrower band at lower speeds only, a resonance below its
    frequency hardly: neither is judged.
    """
    if space.predictor.narrower is None:
        return current
    narrower = replace(space, predictor=space.predictor.narrower)
    while current.terms:
        narrow = fitted(narrower, current.terms)
        apart = _apart(current, narrow, uncertainty_of(space, current), uncertainty_of(narrower, narrow))
        others = [
            fitted(space, [*current.terms[:k], *current.terms[k + 1 :]])
            for k, size in enumerate(apart)
            if size >= _APART
        ]
        if not others:
            break
        current = min(others, key=lambda found: float(np.sum(found.residual[:, space.predictor.rows] ** 2)))
    return current


def in_known_band(space: Space, current: Fit) -> Fit:
    """The fit without the torsional modes and delays that the band in which the motion is known does not show: noise in
    an acceleration makes an inertia too small, or its torque late, at the frequencies at which it is large."""
    predictor = space.predictor
    if not isinstance(predictor, OnMeasuredMotion) or predictor.known_to_Hz >= predictor.corner_hz:
        return current
    known: Space | None = None
    while any(map(_shapes_a_band, current.terms)):
        known = known or replace(space, predictor=predictor.below(predictor.known_to_Hz))
        narrow = fitted(known, current.terms)
        sure, each = uncertainty_of(known, narrow), zip(narrow.terms, strength_parts(narrow.terms), strict=True)
        chances = [sure.chance(part, term.moved) if _shapes_a_band(term) else 0.0 for term, part in each]
        worst = int(np.argmax(chances))
        if chances[worst] <= CHANCE:
            break
        current = fitted(space, [*current.terms[:worst], *current.terms[worst + 1 :]])
    return current


def _shapes_a_band(term: Term) -> bool:
    """True if it changes with the frequency what an inertia needs."""
    return term.is_torsional or term.probe is not None


def in_both_halves(space: Space, current: Fit) -> Fit:
    """The fit without the delays that every other stretch finds in another size than those between.

    A cable is as long in every stretch; what a delay substitutes (an arm that oscillates along) is another from motion
    to motion. Of what the model is linear in each stretch was predicted from the others before.
    """
    rows = space.predictor.rows
    stretches = np.array_split(np.flatnonzero(rows), STRETCHES)
    halves = []
    for first in (0, 1):
        half = np.zeros(len(rows), bool)
        half[np.concatenate(stretches[first::2])] = True
        halves.append(half)
    while any(term.probe is not None for term in current.terms):
        early, late = (fit(space, weights(space, current.terms), current.terms, half) for half in halves)
        sure = [uncertainty_of(space, found, half) for found, half in zip((early, late), halves, strict=True)]
        apart = _apart(early, late, *sure)
        delays = [size if term.probe is not None else 0.0 for size, term in zip(apart, current.terms, strict=True)]
        worst = int(np.argmax(delays))
        if delays[worst] < _APART:
            break
        current = fitted(space, [*current.terms[:worst], *current.terms[worst + 1 :]])
    return current


def _apart(one: Fit, other: Fit, sure: Uncertainty, other_sure: Uncertainty) -> list[float]:
    """Difference of two fits of the same terms in the strength of each, in standard deviations, beyond a share of it
    that makes no other effect of it; 0 of a wave, or what oscillates at a frequency of its own."""
    deviations = np.maximum(np.hypot(sure.deviations, other_sure.deviations), 1e-300)
    found = []
    for a, b, part in zip(one.terms, other.terms, parts(one.terms), strict=True):
        here, there, neutral = (float(term.coordinates()[0]) for term in (a, b, a.neutral()))
        # What a filter rounds of an inertia is a share of all of it, not of what it differs by.
        whole = 1.0 + here if a.effect.domain is Domain.INERTIA else here - neutral
        beyond = abs(here - there) - _SAME_SIZE * abs(whole)
        found.append(0.0 if a.is_of_a_frequency else max(beyond, 0.0) / float(deviations[part.start]))
    return found


#: Share of a response that what such a motion can't distinguish from it has to leave of it.
_OWN_SHARE: Final = 0.25


def is_in_known_band(space: Space, term: Term) -> bool:
    """False of a term that oscillates at a frequency at which the measured motion is noise more than motion."""
    predictor = space.predictor
    if not term.is_torsional or not isinstance(predictor, OnMeasuredMotion):
        return True
    return term.values["frequency_Hz"] <= predictor.known_to_Hz


def is_on_one_sine(space: Space) -> bool:
    """True if a lone axis moves to and fro by one steady sine."""
    return isinstance(space.predictor, OnMeasuredMotion) and space.predictor.sine_Hz is not None


def identifiable_on_one_sine(space: Space, terms: list[Term], offered: CandidateSet) -> list[bool]:
    """True for each candidate that the motion identifies; all of any but one steady sine. A resonance is judged by
    the lines of its spectrum, once it is found (`unidentifiable_modes`)."""
    predictor = space.predictor
    if not isinstance(predictor, OnMeasuredMotion) or predictor.sine_Hz is None:
        return [True] * len(offered.candidates)
    moving = map(_is_law_of_motion, offered.candidates)
    laws = [response for response, is_law in zip(offered.responses, moving, strict=True) if is_law]
    alike = np.concatenate([predictor.alike_on_one_sine(space.packed(terms)), offered.own, *laws])
    counted = alike[..., predictor.rows]
    known = basis(counted[np.any(counted, axis=(1, 2))].reshape(-1, counted.shape[1] * counted.shape[2]))
    each = zip(offered.candidates, offered.responses, strict=True)
    return [
        term.is_torsional
        or _is_law_of_motion(term)
        or (
            own_share(response[..., predictor.rows], known) >= _OWN_SHARE
            # Over less than a turn a wave is any law of the position.
            and not (term.has_phase and predictor.turns < 1.0)
        )
        for term, response in each
    ]


def _is_law_of_motion(term: Term) -> bool:
    """Friction, offset and inertia: without them no other law is read aright."""
    return not term.effect.removable or (term.effect.domain is Domain.INERTIA and not term.is_torsional)


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


def first_unseen(
    space: Space, proposer: Proposer, selection: Selection, deviations: float
) -> Iterator[tuple[Term, float, float]]:
    """Each effect with a frequency that neither model nor selection has at the lowest one, Hz, at which its usual size
    could not be seen, and the strength that could be seen there, inf: none; nothing of one that would be seen at all
    frequencies that are looked at.

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
        yield from [(term, float(f"{_Hz(term):.3g}"), float(s)) for term, s in found if not s <= term.size][:1]


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
