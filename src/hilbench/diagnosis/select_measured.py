"""Rules of a search where a right model would not leave noise alone: prediction on measured motion.

There the torque is nearly linear in every strength, so that one Gram matrix shows what any term explains beside any
others. What is left at the end is never noise; its spectrum is taken for one (`hilbench.diagnosis.residual_noise`). A
term is certain when

- it is neutral by less than a small chance, with the spectrum of what is left beside it as noise,
- it lowers the sum of squares of what is left by more than a share: what is significant and tiny is a part of the
  expansion of something else, and comes and goes from one recording to the next,
- stretches that did not take part in the fit agree.

The simple effects come first (marginality, Nelder 1977): a law of higher order is read beside those that it consists
of.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import chain, compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit, fitted, stated_uncertainty, uncertainty_of
from hilbench.diagnosis.measured_rules import (
    CHANCE,
    LEAST_SHARE,
    TIED,
    WHOLE,
    Offer,
    identifiable_on_one_sine,
    in_both_halves,
    in_every_band,
    in_known_band,
    in_order,
    is_beside_a_whole_order,
    is_in_known_band,
    is_on_one_sine,
    least_share,
    settled_beside,
)
from hilbench.diagnosis.noise import Whitening
from hilbench.diagnosis.proposals import Proposer, by_torque
from hilbench.diagnosis.residual_noise import Uncertainty
from hilbench.diagnosis.selection import CandidateSet, Selection
from hilbench.diagnosis.space import Space, noise_model
from hilbench.diagnosis.stretched_problem import StretchedProblem, basis, own_share, spanning, without
from hilbench.diagnosis.terms import RANK, Key, Place, Term, parts, strength_parts

#: The same beside what the prediction may be off by: of less its 95 % interval has no neutral value.
_NEUTRAL_IN_INTERVAL: Final = 0.05
#: The same of a term that was searched for at many places, over all of them: so many names may be false.
_FALSE: Final = 0.01
#: Share below which the chance has to be smaller in proportion: what explains little has to be the surer.
_LARGE_SHARE: Final = 0.25
#: Share of the sum of squares that is left without a term from which the term stays.
_STAYING_SHARE: Final = 0.04
#: Share of a response that those of the present terms leave of it, below which it says nothing of its own.
_OWN_SHARE: Final = 0.01
#: The same of a wave's response beside those of the laws of motion: where it has the motion's own frequency all along
#: (a small oscillation about a steady speed), inertia and friction make a wave as well.
_OWN_SHARE_OF_WAVE: Final = 0.25
#: Standard deviation of the torque's size over its mean from which it changes by enough to show what goes with it.
_CHANGING: Final = 0.5
#: Additions that are fitted in full at a step.
_CONTENDERS: Final = 6
#: Orders or frequencies from a present one up to which others are its side bands; how many of them on either side.
_NEAR: Final = 0.5
_MOST_SIDE_BANDS: Final = 20.0


class SideBands:
    """Waves near the orders and frequencies of terms: `columns` (J, signals, n), and what spans them where rows count.

    A loop answers to an order in another phase at every speed and in each direction. What that leaves of the order
    is neither an order beside it nor anything else. Where an axis goes there and back each wave has another size
    and phase either way.
    """

    def __init__(self, space: Space, proposer: Proposer, terms: list[Term]) -> None:
        columns = []
        for term in terms:
            name, angle = proposer.searched_angle_rad(term, space.predictor.every)
            if name is None:
                continue
            turns = float(np.ptp(angle)) / (2.0 * np.pi)
            step = max(0.5 / turns, _NEAR / _MOST_SIDE_BANDS)
            offsets = step * np.arange(-int(_NEAR / step), int(_NEAR / step) + 1)
            waves = np.exp(1j * np.outer(term.values[name] + offsets, angle))
            both = np.concatenate([waves.real, waves.imag])
            columns.append(both)
            forward = np.gradient(angle) > 0.0
            counted = forward[space.predictor.rows]
            if term.axis is not None and np.any(counted) and not np.all(counted):
                columns.append(np.where(forward, both, -both))
        signals, n = space.predictor.measured.shape
        self.columns, self._rows = np.empty((0, signals, n)), space.predictor.rows
        if columns:
            found = np.concatenate(columns)
            alone = [found[:, None, :] * np.eye(signals)[k][None, :, None] for k in range(signals)]
            self.columns = np.concatenate(alone)

    @cached_property
    def _spanning(self) -> Array:
        """(B, signals, n), orthonormal on the rows that count."""
        flat, n = self.columns.reshape(len(self.columns), -1), self.columns.shape[-1]
        return spanning(flat, np.tile(self._rows, self.columns.shape[1])).reshape(-1, self.columns.shape[1], n)

    @property
    def basis(self) -> Array:
        """(B, signals·rows): orthonormal rows that span them where rows count."""
        return self._spanning[..., self._rows].reshape(-1, self.columns.shape[1] * int(np.count_nonzero(self._rows)))

    def taken_out_of(self, residual: Array) -> Array:
        """The residual (signals, n) without what they explain of it."""
        if not len(self.columns):
            return residual
        along = np.tensordot(self._spanning[..., self._rows], residual[..., self._rows], 2)
        return np.asarray(residual - np.tensordot(along, self._spanning, 1))


class MeasuredRules:
    """Rules of a search where what is left is never noise."""

    most_terms = 10

    def __init__(self, space: Space, proposer: Proposer) -> None:
        self.space, self.proposer, self._waves = space, proposer, 0
        #: Effects that are as simple as friction: with another axis coupled gravity, of which an offset may be a part.
        self._as_simple = () if space.predictor.arm is None else ("unbalance",)
        self._bands: tuple[Fit, SideBands] | None = None  # last fit that they were asked of

    @property
    def rows(self) -> NDArray[np.bool_]:
        """(n,): those that count."""
        return self.space.predictor.rows

    def fit_of(self, terms: list[Term]) -> Fit:
        """Fitted to all rows that count."""
        return fitted(self.space, terms)

    def pruned(self, current: Fit, white: Whitening) -> Fit:
        """Return the fit as it is: with a gross error of the model nothing is certain, and nothing superfluous."""
        return current

    def continued(self, best: Fit, offered: CandidateSet) -> tuple[Fit, CandidateSet, bool]:
        """Continue with the candidates at the new model; there is always more. What goes round with the axis hides how
        friction turns over: that is looked at again beside it."""
        waves = sum(term.has_phase for term in best.terms)
        if waves > self._waves and not any(term.is_torsional for term in best.terms):
            self._waves = waves
            if (settled := settled_beside(self.space, best)) is not None:
                self.space = replace(self.space, predictor=settled)
                best = self.fit_of(best.terms)
        return best, self.candidates(best), True

    def judged(self, current: Fit, offered: CandidateSet) -> Selection:
        """Select the terms that are certain given all others."""
        found_resonant = any(term.is_torsional for term in current.terms)
        steady = in_both_halves(self.space, in_every_band(self.space, in_known_band(self.space, current)))
        wandering = {term.place for term in current.terms} - {term.place for term in steady.terms}
        certain = self._without_superfluous(self._at_whole_orders(steady))
        if len(certain.terms) < len(current.terms):
            offered = self.candidates(certain)
        current = certain
        tied = self._tied(current, offered, wandering)
        simpler = self._with_first_of_alike(current, tied, offered)
        if simpler is not current:
            current, offered = simpler, self.candidates(simpler)
            tied = self._tied(current, offered, wandering)
        if (fewer := self._with_fewer(current, tied, offered)) is not None:
            current, offered = fewer, self.candidates(fewer)
            tied = self._tied(current, offered, wandering)
        # On one steady sine an inertia replaces a resonance, and leaves more.
        resonant = found_resonant and not any(t.is_torsional for t in current.terms)
        exhausted, few = resonant and is_on_one_sine(self.space), self._unidentifiable(current, tied, offered)
        return Selection(current, offered, tied, self._evidence(current), exhausted, unidentifiable=few)

    # -- fits ----------------------------------------------------------------------------------------------

    def _counted(self, values: Array) -> Array:
        """Rows of (…, signals, n) that count."""
        return values[..., self.rows]

    def _side_bands(self, current: Fit) -> SideBands:
        """Side bands of the terms of a fit."""
        if self._bands is None or self._bands[0] is not current:
            self._bands = current, SideBands(self.space, self.proposer, current.terms)
        return self._bands[1]

    # -- candidates ----------------------------------------------------------------------------------------

    def candidates(self, current: Fit) -> CandidateSet:
        """Every candidate with its response; orders and frequencies from the residual's spectrum."""
        space = self.space
        direct = self.proposer.direct()
        candidates = [t for t in direct if not any(map(t.overlaps, current.terms)) and is_in_known_band(space, t)]
        responses = space.strengths(current.terms, current.residual, candidates)
        own = space.point(current.terms, current.residual).derivatives
        # Without waves: one that acts as a term that is there is looked at as well, to be tied with it.
        mine = zip(parts(current.terms), current.terms, strict=True)
        of_all = [*((own[part], term) for part, term in mine), *zip(responses, candidates, strict=True)]
        laws = np.concatenate([own[:0], *(response for response, term in of_all if not term.has_phase)])
        moving = basis(self._counted(laws).reshape(len(laws), -1))
        is_identified = [
            not term.has_phase
            or term.effect.id in self._as_simple
            or own_share(self._counted(response), moving) >= _OWN_SHARE
            for term, response in zip(candidates, responses, strict=True)
        ]
        candidates, responses = list(compress(candidates, is_identified)), list(compress(responses, is_identified))
        white = noise_model(space, current.residual, np.concatenate([own, *responses]))
        searched = self._searched(current, white)
        more = space.strengths(current.terms, current.residual, searched)
        is_identified = [own_share(self._counted(response), moving) >= _OWN_SHARE_OF_WAVE for response in more]
        # What grows with the torque is no more identified than what does not, where that may be there as well.
        too_alike = [
            self.order(term) for term, yes in zip(searched, is_identified, strict=True) if not (yes or by_torque(term))
        ]
        is_identified = [
            yes and not (by_torque(term) and self.order(term) in too_alike)
            for term, yes in zip(searched, is_identified, strict=True)
        ]
        searched, more = list(compress(searched, is_identified)), list(compress(more, is_identified))
        return CandidateSet(white, current.residual, own, candidates + searched, responses + more)

    def _searched(self, current: Fit, white: Whitening) -> list[Term]:
        """Orders and frequencies from the residual's spectrum, as it is and whitened, in addition to those present.

        Where a turn is resolved the nearest whole number of times a turn is offered as well: rotating parts have such
        orders, and a drive's loop that answers in another phase in each direction splits their peak.
        """
        found: list[Term] = []
        beside = self._side_bands(current).taken_out_of(current.residual)
        for apply in (lambda values: values, white.apply):
            left = np.where(self.rows, apply(beside), 0.0)
            named = dict(zip(self.space.predictor.names, left, strict=True))
            terms = self.proposer.searched(named, current.terms, self.space.predictor.every)
            responses = self.space.strengths(current.terms, current.residual, terms)
            for term, response in zip(terms, responses, strict=True):
                masked = np.where(self.rows, apply(response), 0.0)
                found.append(self.proposer.tuned(term, left, masked, self.space.predictor.every)[0])
        there = [self.order(term) for term in current.terms if term.has_phase]  # a wave near one is its side band
        found = [t for t in found if not (t.has_phase and any(abs(one - self.order(t)) < _NEAR for one in there))]
        found += [plain for term in found for plain in self.proposer.plainer(term, current.terms)]
        return found + [whole for term in found for whole in self.proposer.at_whole_orders(term)]

    def order(self, wave: Term) -> float:
        """Times a turn of the motor; once a turn of what it drives where the law has no order."""
        name, _ = self.proposer.searched_angle_rad(wave, self.space.predictor.every)
        if name is not None:
            return wave.values[name]
        return 1.0 if wave.axis is None else 1.0 / self.space.model.gear_ratio(wave.axis)

    def _linear(
        self, residual: Array, own: Array, offered: CandidateSet, beside: SideBands | None = None
    ) -> StretchedProblem:
        """Linear problem of the terms' own columns and of the candidates.

        beside: columns of which nothing is looked at: projected out of all the others beforehand, because their amounts
        in one stretch do not hold in the others.
        """
        columns = self._counted(np.concatenate([own, *offered.responses]))
        counted = self._counted(residual)
        raw = np.sum(columns**2, axis=(1, 2))
        if beside is not None and len(beside.columns):
            columns, counted = without(columns, beside.basis), without(counted[None], beside.basis)[0]
        return StretchedProblem.of(counted, columns, raw)

    # -- additions ---------------------------------------------------------------------------------------

    def best_addition(self, current: Fit, offered: CandidateSet) -> Fit | None:
        """The fit with the candidate that explains most of those that are certain; the simple ones go first."""
        problem = self._linear(offered.residual, offered.own, offered, self._side_bands(current))
        mine, members = list(range(len(offered.own))), offered.members(len(offered.own))
        simple = [column for term, group in members if not term.effect.removable for column in group]
        before, before_unseen = problem.left(mine)[0], problem.left_unseen(mine)
        beside_simple = problem.left([*mine, *simple])[0]
        waves = [(term, self._wave_gain(problem, mine, group)) for term, group in members if term.has_phase]
        whole = [(term, problem.gain_by_stretch(mine, group)) for term, group in members if term.held]
        offers = []
        for term, group in compress(members, identifiable_on_one_sine(self.space, current.terms, offered)):
            started, least = self._started(problem, mine, term, group), least_share(term)
            if started is None or before - started[0] < least * before:
                continue
            # A law of higher order is fitted with those that it consists of, even where these are not identified.
            if term.effect.removable and problem.own_share(group[0], [*mine, *simple]) < _OWN_SHARE:
                continue
            if term.effect.removable and problem.left([*mine, *simple, *group])[0] > (1.0 - least) * beside_simple:
                continue
            unseen, free = before_unseen - problem.left_unseen([*mine, *group]), 0.0
            if term.has_phase:
                unseen, free = problem.gain_unseen_in_phase(mine, group), problem.gain_by_stretch(mine, group)
            if unseen < 0.5 * least * before_unseen:
                continue
            its = next((gain for other, gain in waves if other is term), 0.0)
            if not any(self._is_as_good_a_wave(other, gain, term, its) for other, gain in waves):
                offers.append(Offer(started[1], started[0], problem.own_share(group[0], mine), free))
        offers = [offer for offer in offers if not is_beside_a_whole_order(offer, whole)]
        for offer in in_order(offers, self._as_simple)[:_CONTENDERS]:
            found = fitted(self.space, [*current.terms, offer.term])
            if not all(is_in_known_band(self.space, term) for term in found.terms):
                continue
            left = self._counted(self._side_bands(current).taken_out_of(found.residual))
            if float(np.sum(left**2)) < (1.0 - least_share(offer.term)) * before:
                return found
        return None

    def _wave_gain(self, problem: StretchedProblem, mine: list[int], group: list[int]) -> float:
        """Gain of a wave with free phases; where the size of the torque hardly changes with free amplitudes, too.

        There what goes with the torque, and what goes with the direction, are one.
        """
        sizes = np.abs(self._counted(self.space.predictor.measured))
        if np.all(np.std(sizes, axis=-1) < _CHANGING * np.mean(sizes, axis=-1)):
            return problem.gain_by_stretch(mine, group)
        return problem.gain_unseen_in_phase(mine, group)

    def _is_as_good_a_wave(self, other: Term, gain: float, wave: Term, its: float) -> bool:
        """True if a simpler wave of the same order explains nearly as much when phases are free.

        A loop that answers in another phase in each direction makes a wave look like one that goes with the torque.
        """
        if not wave.has_phase or RANK[other.effect.id] >= RANK[wave.effect.id]:
            return False
        return abs(self.order(other) - self.order(wave)) < _NEAR and gain >= WHOLE * its

    @staticmethod
    def _started(problem: StretchedProblem, mine: list[int], term: Term, group: list[int]) -> tuple[float, Term] | None:
        """Residual sum with a candidate, and its start values; None where it is collinear or no bound allows its
        sign."""
        if min(problem.own_share(column, mine) for column in group) < _OWN_SHARE:
            return None
        left, theta = problem.left([*mine, *group])
        strength = term.neutral().coordinates()[: term.linear] + theta[len(mine) :]
        started = term.of_strength(strength)
        if not term.allowed(float(strength[0])):
            # A bound is as far as it goes: what it explains there counts.
            if not np.any(started.moved):
                return None
            left = problem.left_with(mine, group, started.moved)
        return left, started

    def _chances(self, found: Fit, known: Uncertainty | None = None) -> list[float]:
        """Probability for each term that it is neutral and was found by chance; known: by default with the residual
        as noise."""
        known = uncertainty_of(self.space, found) if known is None else known
        return [known.chance(part, t.moved) for t, part in zip(found.terms, strength_parts(found.terms), strict=True)]

    # -- earlier choices ---------------------------------------------------------------------------------

    def _without_superfluous(self, current: Fit) -> Fit:
        """The fit without the terms that the others have made uncertain, one by one, the least certain first."""
        while current.terms:
            chances, shares = self._chances(current), self._shares(current)
            stated = self._chances(current, stated_uncertainty(self.space, current))
            for k in np.argsort(chances)[::-1]:
                term = current.terms[k]
                least = _STAYING_SHARE / LEAST_SHARE * least_share(term)
                chance = CHANCE / term.multiplicity * min(1.0, shares[k] / _LARGE_SHARE)
                neutral = _FALSE / term.multiplicity if term.multiplicity > 1.0 else _NEUTRAL_IN_INTERVAL
                if chances[k] > chance or shares[k] < least or stated[k] > neutral:
                    current = fitted(self.space, [*current.terms[:k], *current.terms[k + 1 :]])
                    break
            else:
                break
        return current

    def _shares(self, current: Fit) -> list[float]:
        """Share by which each term lowers what is left without it, the others free to adapt.

        Of what is no wave beside the side bands of the waves: a delay makes up for a phase that changes with the speed.
        """
        own = self.space.point(current.terms, current.residual).derivatives
        both, shares = np.concatenate([own, self._side_bands(current).columns]), []
        problems = [StretchedProblem.of(self._counted(current.residual), self._counted(each)) for each in (both, own)]
        for term, part in zip(current.terms, parts(current.terms), strict=True):
            problem = problems[term.has_phase]
            everything = range(len(problem.raw))
            here = problem.left(list(everything))[0]
            back = problem.with_back(everything[part][: term.linear], term.moved)
            shares.append(1.0 - here / max(back.left([c for c in everything if c not in everything[part]])[0], 1e-300))
        return shares

    def _tied(self, current: Fit, offered: CandidateSet, wandering: set[Place]) -> dict[Key, list[Place]]:
        """Alternatives to each term that leave as little, but for those on which no two bands agree."""
        tied: dict[Key, list[Place]] = {}
        count = len(offered.own)
        problem, members = self._linear(current.residual, offered.own, offered), offered.members(count)
        here = problem.left(list(range(count)))[0]
        for term, part in zip(current.terms, parts(current.terms), strict=True):
            mine = [c for c in range(count) if c not in range(part.start, part.stop)]
            # The residual without the term, as far as it is linear in it.
            without = problem.with_back(range(count)[part][: term.linear], term.moved)
            tied[term.key] = []
            for other, group in members:
                if other.place in {term.place, *wandering, *tied[term.key]}:
                    continue
                if term.effect.removable or other.effect.removable:
                    started = self._started(without, mine, other, group)
                    left = float("inf") if started is None else started[0]
                elif min(without.own_share(column, mine) for column in group) < _OWN_SHARE:
                    continue
                else:  # more of it may be fed forward than there is: its sign has no meaning
                    left = without.left([*mine, *group])[0]
                if left < (1.0 + TIED) * here:
                    tied[term.key].append(other.place)
            tied[term.key] += self._alike(current, term, here, offered, {*wandering, *tied[term.key]})
        return tied

    def _alike(
        self, current: Fit, term: Term, left: float, offered: CandidateSet, known: set[Place]
    ) -> Iterator[Place]:
        """Effects that some recordings can't distinguish from the term's, and these can't.

        Beside the term their responses say nothing of it (what is fed forward goes with an inertia that the term has
        taken away), so each is fitted in its place.
        """
        rest = [other for other in current.terms if other is not term]
        for other in offered.candidates:
            if other.place in known or other.place == term.place or other.axis != term.axis:
                continue
            if other.has_phase or not other.effect.is_alike(term.effect):
                continue
            instead = self._counted(fitted(self.space, [*rest, other]).residual)
            if float(np.sum(instead**2)) < (1.0 + TIED) * left:
                known.add(other.place)
                yield other.place

    def _with_first_of_alike(self, current: Fit, tied: dict[Key, list[Place]], offered: CandidateSet) -> Fit:
        """The fit with the first in the table of each term and what is alike and tied with it: an inertia that the
        torque lacks is named, not one of the reasons why it may lack it."""
        for term in current.terms:
            instead = [
                other
                for other in offered.candidates
                if other.place in tied[term.key] and other.effect.is_alike(term.effect) and not other.has_phase
                if RANK[other.effect.id] < RANK[term.effect.id]
            ]
            if instead:
                first = min(instead, key=lambda other: RANK[other.effect.id])
                found = fitted(self.space, [first if one is term else one for one in current.terms])
                return self._with_first_of_alike(found, {one.key: [] for one in found.terms} | tied, offered)
        return current

    def _at_whole_orders(self, current: Fit) -> Fit:
        """The fit with each wave at a whole order that leaves as little."""
        for k, term in enumerate(current.terms):
            for whole in [] if term.held else self.proposer.at_whole_orders(term):
                found = fitted(self.space, [*current.terms[:k], whole, *current.terms[k + 1 :]])
                if self._left(found) < (1.0 + TIED) * self._left(current):
                    current = found
                    break
        return current

    def _left(self, found: Fit) -> float:
        """Sum of squares of what a fit leaves in the rows that count."""
        return float(np.sum(self._counted(found.residual) ** 2))

    def _with_fewer(self, current: Fit, tied: dict[Key, list[Place]], offered: CandidateSet) -> Fit | None:
        """The fit in which what is tied with a term, in its place, makes others superfluous and leaves as little: one
        effect is likelier than two that together do the same."""
        most = (1.0 + TIED) * self._left(current)
        for term in current.terms:
            for other in offered.candidates:
                if other.place in tied[term.key] and not other.has_phase:
                    rest = [one for one in current.terms if one is not term]
                    found = self._without_superfluous(fitted(self.space, [*rest, other]))
                    if len(found.terms) < len(current.terms) and self._left(found) < most:
                        return found
        return None

    def _unidentifiable(self, current: Fit, tied: dict[Key, list[Place]], offered: CandidateSet) -> list[Term]:
        """A candidate of each place of which this motion can distinguish none, and that is tied with nothing."""
        is_identified = identifiable_on_one_sine(self.space, current.terms, offered)
        known = {*(term.place for term in current.terms), *chain.from_iterable(tied.values())}
        known |= {term.place for term in compress(offered.candidates, is_identified)}
        return list({term.place: term for term in offered.candidates if term.place not in known}.values())

    def _evidence(self, current: Fit) -> dict[Key, dict[str, float]]:
        if not current.terms:
            return {}
        judged = zip(current.terms, self._chances(current), self._shares(current), strict=True)
        return {term.key: {"chance_if_neutral": chance, "share_of_rest": share} for term, chance, share in judged}
