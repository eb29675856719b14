"""Test of what a search has found against its alternatives, where a right model leaves noise alone.

Each term must show that the model is worse without it, and that no other explains the same as well: equal ones are tied
with it; one that explains more replaces it, and everything is tested again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit, around, fit, sums
from hilbench.diagnosis.noise import Whitening
from hilbench.diagnosis.selection import Better, CandidateSet, Selection
from hilbench.diagnosis.space import finest
from hilbench.diagnosis.steps import MARGIN, TIED, Steps, price
from hilbench.diagnosis.terms import RANK, Key, Place, Term, parts

#: How many are fitted in the place of a term.
_ALTERNATIVES: Final = 7
#: Difference of the criterion up to which a step of E is not given up for what the vocabulary does not have.
_DECISIVE: Final = 20.0
#: Share of what one term does that another has to do as well to be started where both do the same.
_ACTS_ALIKE: Final = 0.98
#: Where play makes the sum of squares rough the strength is looked for beside the one that acts as strongly: up to
#: which share of it, in how many steps, and how often ever closer.
_CLOSEST_SHARE, _CLOSEST_STEPS, _CLOSEST_LEVELS = 0.1, 13, 5
#: Share of a usual force with which its response is looked at; how far from a step's time, and in which steps, it is
#: looked for, s.
_FORCE_SHARE: Final = 0.05
_FORCE_SEARCH: Final = (0.02, 0.002)


class FreeRules(Steps):
    """Rules of a search where a right model leaves noise alone, with the test of what it has found."""

    def judged(self, current: Fit, offered: CandidateSet) -> Selection:
        """Each term against its alternatives."""
        # What is not explained would be spread over the alternatives of every term: they would all seem tied.
        if self.is_rough(current):
            return Selection(current, offered, self.samples)
        current, tied, evidence = self.tested(current, offered)
        better = self._against_forces(current, offered, tied)
        return Selection(current, offered, self.samples, tied, evidence, better=better)

    def tested(
        self, current: Fit, offered: CandidateSet
    ) -> tuple[Fit, dict[Key, list[Place]], dict[Key, dict[str, float]]]:
        """Test each term against its alternatives: the fit, what is tied with each term, and the evidence.

        When a term turns out to be superfluous, or something else explains more, everything is tested again from there:
        the evidence of each term is conditional on the others.
        """
        tied: dict[Key, list[Place]] = {}
        evidence: dict[Key, dict[str, float]] = {}
        fine = finest(self.space) or offered.whitening
        close = fit(self.space, fine, current.terms)
        for k in range(len(current.terms)):
            term = current.terms[k]
            rest = current.terms[:k] + current.terms[k + 1 :]
            here = current.train + price(current.terms, self.samples)
            without = fit(self.space, offered.whitening, rest)
            evidence[term.key] = {
                "likelihood_ratio": without.train - current.train,
                "criterion_gain": without.train + price(rest, self.samples) - here,
                "held_out_gain": without.test - current.test,
            }
            if evidence[term.key]["criterion_gain"] <= 0.0:
                offered = self.candidates(without)
                current = self.again(without, offered.whitening)
                # a gradual change may have become a sudden one there, which has fewer coordinates
                own = self.space.point(current.terms, current.residual).derivatives
                return self.tested(current, replace(offered, own=own))
            # The others as they are: fitted without the term they may have run far off.
            left = self.space.residual(rest)
            own = np.delete(offered.own, parts(current.terms)[k], axis=0)
            others = self.ranked(offered, left, own, _ALTERNATIVES)
            tied[term.key] = []
            # What was proposed beside a gradual change says nothing of a sudden one in its middle. A wave that was
            # searched for among all orders has its price; once a turn is no more far-fetched than the term.
            sudden = [[other] for other in self.proposer.at_once(term, rest)]
            round_as_well = [[other] for other in self.proposer.once_a_turn(term)]
            for terms in sudden + round_as_well + others:
                if len(terms) > 1 or terms[0].place == term.place:
                    continue
                cost = price([*rest, *terms], self.samples) - price(current.terms, self.samples)
                alike = None if terms in sudden else self._acting_alike(fine, current, k, terms[0], left)
                # With finer tolerances than the search, and on all rows: between good explanations small things decide.
                found = fit(self.space, fine, [*rest, alike or terms[0]], worth=close.train + MARGIN - cost)
                difference = found.train + found.test + cost - close.train - close.test
                if alike is not None and difference > TIED:
                    found = fit(self.space, fine, self._with_closest_strength(fine, close.terms, k, alike))
                    # On a rough ground another point that is a little lower is no better explanation.
                    difference = max(found.train + found.test + cost - close.train - close.test, -TIED)
                simpler = abs(difference) <= TIED and RANK[terms[0].effect.id] < RANK[term.effect.id]
                better = difference < -TIED or simpler
                # With an equally good explanation another term may be superfluous: two effects replace three.
                if better or (
                    abs(difference) < TIED and len(self.pruned(found, offered.whitening).terms) < len(found.terms)
                ):
                    in_place = [*found.terms[:k], found.terms[-1], *found.terms[k:-1]]
                    current = self.pruned(fit(self.space, offered.whitening, in_place), offered.whitening)
                    offered = self.candidates(current)
                    return self.tested(fit(self.space, offered.whitening, current.terms), offered)
                if abs(difference) < TIED or difference < 0.0:
                    tied[term.key].append(terms[0].place)
        return current, tied, evidence

    def _against_forces(self, current: Fit, offered: CandidateSet, tied: dict[Key, list[Place]]) -> Better | None:
        """Each sudden term against the step of a force that it may be mistaken for; that where it explains more.

        `tied`: gets the force where the two explain as much.
        """
        for k, term in enumerate(current.terms):
            lookalike = term.effect.lookalike
            if term.duration_s > 2.0 * _FORCE_SEARCH[0]:
                continue  # no sudden force, nor anything like one
            if lookalike is None or term.section not in (None, self.space.model.span_count):
                continue  # a force at the last roller acts behind the last span
            difference, force_N, time_s = self._as_a_force(current, k, offered.whitening)
            if difference < -_DECISIVE:
                detail = f"{force_N:.4g} N from t = {time_s:.3f} s on explain it better than {term.effect.id}"
                return Better(lookalike.name, detail)
            if difference < TIED:
                tied[term.key].append(Place(lookalike.name))
        return None

    def _as_a_force(self, current: Fit, k: int, white: Whitening) -> tuple[float, float, float]:
        """Rise of the sum of squares when term k is a step of a force instead; the force, N, and its time, s.

        The force is looked for near the time of the term, with the other terms free to adapt to it.
        """
        space, rows = self.space, self.space.split.block >= 0
        term, rest = current.terms[k], [*current.terms[:k], *current.terms[k + 1 :]]
        point = space.point(rest)
        own = [white.apply(column)[:, rows].ravel() for column in point.derivatives]
        residual = white.apply(point.residual)[:, rows].ravel()
        probe_N = _FORCE_SHARE * self.proposer.sizes(None).force_N
        best = (float("inf"), 0.0, 0.0)
        for time_s in around(term.time_s + 0.5 * term.duration_s, *_FORCE_SEARCH):
            pushed = space.residual_with_force(rest, probe_N, float(time_s))
            response = white.apply(point.residual - pushed)[:, rows].ravel() / probe_N
            columns = np.array([*own, response])
            theta, *_ = np.linalg.lstsq(columns.T, residual, rcond=None)
            square = float(np.sum((residual - theta @ columns) ** 2))
            best = min(best, (square, float(theta[-1]), float(time_s)))
        close = sum(sums(space, white, current.residual))
        return best[0] - close, best[1], best[2]

    def _acting_alike(self, white: Whitening, current: Fit, k: int, other: Term, left: Array) -> Term | None:
        """Alternative to term k, as strong as that where the two act alike; None where they do not.

        left: raw residual without term k. Where play makes the machine's response rough, that promises another
        strength, from which the fit does not come back, and what a small step of a strength does says nothing.
        """
        term = current.terms[k]
        if len(term.coordinates()) > 1 or len(other.coordinates()) > 1:
            return None
        without = self.space.residual([*current.terms[:k], *current.terms[k + 1 :], other])
        acts = self.trained(white.apply(left - np.stack([current.residual, without])))
        (own, across), (_, its) = np.tensordot(acts, acts, ((1, 2), (1, 2)))
        if not across**2 > _ACTS_ALIKE * own * its:
            return None
        neutral = other.neutral().coordinates()
        strength = neutral + across / its * (other.coordinates() - neutral)
        return other.at(strength) if other.allowed(float(strength[0])) else None

    def _with_closest_strength(self, white: Whitening, terms: list[Term], k: int, other: Term) -> list[Term]:
        """The terms with another in the place of term k, at the strength near its own that leaves least.

        A fit goes downhill, which where play makes the sum of squares rough leads anywhere.
        """
        rest = [*terms[:k], *terms[k + 1 :]]
        (strength,) = other.coordinates()
        half = _CLOSEST_SHARE * abs(strength)
        for _ in range(_CLOSEST_LEVELS):
            tried = [other.at(np.array([at])) for at in strength + half * np.linspace(-1.0, 1.0, _CLOSEST_STEPS)]
            residuals = self.space.residuals([[*rest, one] for one in tried])
            best = int(np.argmin([sum(sums(self.space, white, residual)) for residual in residuals]))
            other = tried[best]
            (strength,) = other.coordinates()
            half *= 2.0 / (_CLOSEST_STEPS - 1)
        return [*rest, other]
