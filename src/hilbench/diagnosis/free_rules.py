"""Rules of a search where a right model leaves noise alone: candidates, additions, and the test against alternatives.

Every candidate's response is simulated once, at a later step only that of one which may matter there; the Gram matrix
then says what any one or two of them would explain. The best few are fitted in full, jointly with what is there. A term
stays when the criterion (sum of squares of whitened residuals plus a price for every parameter and every variant that
was searched) falls, and the held-out stretches agree. At the end each must show that the model is worse without it, and
that no other explains the same as well: equal ones are tied with it; one that explains more replaces it, and everything
is tested again.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.fit import TIME_SEARCH, Fit, OnsetResponses, fit, sums, with_best_time
from hilbench.diagnosis.noise import Whitening, scaling
from hilbench.diagnosis.predictor import deviations_of, torques_of
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_analysis import Misfit, exceeds_noise
from hilbench.diagnosis.selection import CandidateSet, Selection
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import StretchedProblem
from hilbench.diagnosis.terms import RANK, Key, Place, Term, parts
from hilbench.plant.effect import Effect, Section

#: Candidates (and pairs of them) that are fitted in full at a step.
_CONTENDERS, _PAIRS = 4, 2
#: How many more are, each by itself, where none of those explains all at the first step.
_NEXT: Final = 4
#: How far above its price a candidate has to promise to explain to be fitted, a promise being that of a linear model,
#: and to be simulated anew at another model: below it explains hardly more than one of pure noise.
_PROMISING, _FAR_FROM_PROMISING = -5.0, -15.0
#: Shares of its price, and of what the best candidate explains, that an order or frequency has to explain to be looked
#: at more closely.
_OF_ITS_PRICE, _OF_THE_BEST = 0.5, 0.1
#: By how much the promises of two candidates differ that are not the same.
_SAME_PROMISE: Final = 0.5
#: Singles from which pairs are made.
_PAIRED_FROM: Final = 14
#: Price of a term beyond the one for its parameters: 2·ln of the number of places it was chosen from.
_PLACES: Final = 60.0
#: Fall of the held-out sum of squares from which it speaks for a term: 1.5 standard errors of its own size.
_HELD_OUT_ERRORS: Final = 1.5
#: Ratio to the rms that noise alone may make from which the right model was certainly not found.
_ROUGH: Final = 1.05
#: Sum of squares of an addition's response on the held-out rows from which they can confirm or refute it.
_OBSERVABLE: Final = 30.0
#: Factor up to which a response to a probe speaks for other strengths of a law that is far from linear.
_TRUSTED: Final = 1.8
#: Standard deviations of its mean square from which a whitened signal is more than noise.
_CALM: Final = 5.0
#: Difference of the criterion up to which two explanations are tied, as for BIC.
TIED: Final = 6.0
#: Fall of the training rows' sum of squares that a fit must promise short of, to be finished and judged on all rows.
MARGIN: Final = 60.0
#: How often, and at which shares of their distance, the best times of a step are looked at more closely; how many are
#: proposed, and how many of the distances they are apart.
_TIME_LEVELS: Final = 5
_CLOSER: Final = np.linspace(-0.75, 0.75, 7)
_STEP_PEAKS, _APART = 2, 2.5
#: How often the ends of what grows over a while are looked for more closely, and among how many times. The mean of
#: steps is taken for a ramp where they are close to each other beside the web's ringing.
_RAMP_LEVELS, _RAMP_TIMES = 2, 24
#: Information on a strength below which these data say nothing of it.
_LEAST_INFORMATION: Final = 1e-6
#: Share of a response that the rest leaves of it, below which two effects added together are one for these data.
_OWN_SHARE: Final = 0.005
#: Ridge of the linear problem, as a share of each column's square.
_RIDGE: Final = 1e-10

#: How many are fitted in the place of a term.
_ALTERNATIVES: Final = 7
#: Difference of the criterion up to which a step of E is not given up for what the vocabulary does not have.
_DECISIVE: Final = 20.0
#: Share of what one term does that another has to do as well to be started where both do the same.
_ACTS_ALIKE: Final = 0.98
#: Where play makes the sum of squares rough the strength is looked for beside the one that acts as strongly: up to
#: which share of it, in how many steps, and how often ever closer.
_CLOSEST_SHARE, _CLOSEST_STEPS, _CLOSEST_LEVELS = 0.1, 13, 5
#: Share of a usual force with which its response is looked at; how far from a step's time, and how exactly, its time is
#: looked for, s.
_FORCE_SHARE: Final = 0.05
_FORCE_SEARCH: Final = (0.02, 0.002)


def price(terms: list[Term], samples: float) -> float:
    """Price of the terms' parameters and their search, in units of the sum of squares."""
    parameters = sum(len(term.coordinates()) for term in terms)
    return parameters * float(np.log(samples)) + sum(2.0 * float(np.log(_PLACES * t.multiplicity)) for t in terms)


def _apart(terms: list[Term], gains: Array, least_s: float) -> list[Term]:
    """Terms of most gain, at least `least_s` apart."""
    found: list[Term] = []
    for k in np.argsort(-gains):
        if all(abs(terms[k].time_s - other.time_s) > least_s for other in found):
            found.append(terms[k])
    return found[:_STEP_PEAKS]


def _best_while(times_s: Array, responses: Array, along: Array) -> tuple[float, float, float]:
    """Begin and end, s, among the times (T,) between which the mean of the responses (T, …) would explain most, and how
    much of the sum of squares; along (T,): products of the responses with the residual."""
    gram = responses @ responses.T
    best, chosen = 0.0, (0, 1)
    for first, last in combinations(range(len(times_s)), 2):
        weights = np.zeros(len(times_s))
        weights[first : last + 1] = 1.0
        weights[[first, last]] = 0.5
        gain = float(weights @ along) ** 2 / max(float(weights @ gram @ weights), 1e-300)
        if gain > best:
            best, chosen = gain, (first, last)
    return float(times_s[chosen[0]]), float(times_s[chosen[1]]), best


def _is_beyond_chance(gain: float) -> bool:
    """True if a fall of a sum of squares is: the whitened noise has variance 1, so that its standard error is
    2·√gain."""
    return gain > 0.0 and gain > _HELD_OUT_ERRORS * 2.0 * float(np.sqrt(gain))


class FreeRules:
    """Rules of a search where a right model leaves noise alone."""

    #: Three that leave more than noise are none of them right, and many small ones together are a series expansion of
    #: something else.
    most_terms = 3

    def __init__(self, space: Space, proposer: Proposer) -> None:
        self.space, self.proposer, self._every = space, proposer, space.predictor.every
        self._white = scaling(deviations_of(space.predictor))

    @property
    def rows(self) -> NDArray[np.bool_]:
        """(n,): those of the blocks."""
        return np.asarray(self.space.split.block >= 0)

    @property
    def samples(self) -> float:
        """Number of values that fits see."""
        return float(np.count_nonzero(self.space.split.train) * len(self.space.predictor.names))

    # -- candidates ------------------------------------------------------------------------------------------

    def fit_of(self, terms: list[Term]) -> Fit:
        residual = self.space.residual(terms)
        return Fit(terms, residual, float("nan"), float("nan"), np.empty((0, 0)))

    def again(self, current: Fit, white: Whitening) -> Fit:
        """Fit the same terms again.

        What sets in at once is put to the time that is best beside the others; what has grown so fast that it might as
        well have set in at once does.
        """
        found = fit(self.space, white, current.terms)
        for k, term in enumerate(current.terms):
            rest = [*found.terms[:k], *found.terms[k + 1 :]]
            sudden = [found.terms[k]] if term.is_sudden and rest else self.proposer.at_once(found.terms[k], rest)
            for other in sudden:
                terms = with_best_time(self.space, white, [*found.terms[:k], other, *found.terms[k + 1 :]], k)
                aimed = fit(self.space, white, terms)
                if self.criterion(aimed) < self.criterion(found):
                    found = aimed
        return found

    def criterion(self, found: Fit) -> float:
        """Selection criterion of a fit on all rows."""
        return found.train + found.test + price(found.terms, self.samples)

    def candidates(self, current: Fit, known: CandidateSet | None = None) -> CandidateSet:
        """Candidates at a model, each with its response.

        known: a set at another model (`carried_over`); of its direct candidates those that are far from promising
        anything keep their responses.
        """
        space = self.space
        direct = [t for t in self.proposer.direct() if not any(map(t.overlaps, current.terms))]
        responses = self._responses(current, direct, known)
        own, white = space.point(current.terms, current.residual).derivatives, self._white
        whitened = self.masked(white.apply(current.residual))
        named = dict(zip(space.predictor.names, whitened, strict=True))
        searched = self.proposer.searched(named, current.terms, self._every)
        searched += self._changes(current, white)
        searched += self._passages(current, white, named)
        more = space.strengths(current.terms, current.residual, searched)
        tuned = self._tune(current, white, searched, more, responses)
        whole = self._at_whole_orders([searched[k] for k in tuned])
        searched, responses = searched + whole, responses + more
        responses = responses + space.strengths(current.terms, current.residual, whole)
        return CandidateSet(white, current.residual, own, direct + searched, responses)

    def _responses(self, current: Fit, direct: list[Term], known: CandidateSet | None) -> list[Array]:
        """Responses of direct candidates; of those that are far from promising anything as they are known."""
        if known is None:
            return self.space.strengths(current.terms, current.residual, direct)
        promising = self.ranked(known, known.residual, known.own, len(known.candidates), _FAR_FROM_PROMISING)
        places = {term.place for terms in promising for term in terms}
        by_term = {
            (t.key, t.probe, *t.values.items()): response
            for t, response in zip(known.candidates, known.responses, strict=True)
            if t.place not in places
        }
        found = [by_term.get((t.key, t.probe, *t.values.items())) for t in direct]
        new = [t for t, response in zip(direct, found, strict=True) if response is None]
        anew = iter(self.space.strengths(current.terms, current.residual, new))
        return [next(anew) if response is None else response for response in found]

    def _changes(self, current: Fit, white: Whitening) -> list[Term]:
        """Terms of each sudden effect at the times at which it would explain most, and gradual ones over a while."""
        times, apart_s = self.proposer.onset_times_s()
        counted = np.flatnonzero(self.rows) * self.space.period_s * self._every
        # What set in before the first row that counts has been there always.
        times = times[(times > counted[0]) & (times < counted[-1])]
        sudden = self.proposer.sudden()
        return [
            term
            for effect in sudden
            for _, section in machines.places(self.space.model, effect)
            for term in self._changes_by(effect, current, white, times, apart_s, section)
        ]

    def _passages(self, current: Fit, white: Whitening, whitened: dict[str, Array]) -> list[Term]:
        """Terms of each passing effect at the times at which it would explain most, near where the residual is
        large."""
        effects = self.proposer.passing()
        if not effects:
            return []
        times, apart_s = self.proposer.passage_times_s(whitened, self.rows, self._every)
        found = (self._changes_by(effect, current, white, times, apart_s) for effect in effects if len(times))
        return [term for terms in found for term in terms]

    def _changes_by(
        self,
        effect: Effect,
        current: Fit,
        white: Whitening,
        times: Array,
        apart_s: float,
        section: Section | None = None,
    ) -> list[Term]:
        """One sudden effect: a coarse grid of times, then ever closer ones around the best.

        What it explains has a narrow peak at the right time. A fit started beside it runs into another minimum, and
        simulating every time would cost thousands of runs: responses at the closer times follow from those of the grid.
        """
        terms = self.proposer.onsets(effect, np.append(times, 0.0), current.terms, section)
        if not terms:  # the model can't have one more of it
            return []
        *responses, always = (response[0] for response in self.space.strengths(current.terms, current.residual, terms))
        known = OnsetResponses(times, np.array(responses), always, self.space.period_s * self._every)
        found, gradual = list[Term](), list[Term]()
        for level in range(_TIME_LEVELS):
            terms = self.proposer.onsets(effect, times, current.terms, section)
            seen, along = self._seen(current, white, known, times)
            if level == 0 and self.proposer.gradual(effect, 0.0, 1.0, current.terms, section):
                gradual = self._gradual(effect, current, white, known, section)
            found = _apart(terms, along**2 / np.maximum(np.sum(seen**2, axis=1), 1e-300), _APART * apart_s)
            times = np.concatenate([t.time_s + apart_s * _CLOSER for t in found]) if found else times
            apart_s *= float(_CLOSER[1] - _CLOSER[0])
        return [*found, *gradual]

    def _seen(self, current: Fit, white: Whitening, known: OnsetResponses, times_s: Array) -> tuple[Array, Array]:
        """Whitened responses (T, signals·n) of what sets in at these times, and their products (T,) with the
        residual."""
        responses = np.array([self.masked(white.apply(known.at(float(time)))).ravel() for time in times_s])
        return responses, responses @ self.masked(white.apply(current.residual)).ravel()

    def _gradual(
        self, effect: Effect, current: Fit, white: Whitening, known: OnsetResponses, section: Section | None
    ) -> list[Term]:
        """Terms that grow between two of the known times, those that would explain most; then between closer ones.

        The response of a ramp is the mean of those of the steps within it, so no ramp need be simulated.
        """
        times_s = known.times_s
        first_s, last_s = float(times_s[0]), float(times_s[-1])
        begin_s, end_s, gain = _best_while(times_s, *self._seen(current, white, known, times_s))
        for _ in range(_RAMP_LEVELS):
            if gain < float(np.log(self.samples)):  # nothing that could be named
                break
            apart_s = float(times_s[1] - times_s[0])
            times_s = np.linspace(max(begin_s - apart_s, first_s), min(end_s + apart_s, last_s), _RAMP_TIMES)
            begin_s, end_s, gain = _best_while(times_s, *self._seen(current, white, known, times_s))
        return self.proposer.gradual(effect, begin_s, end_s - begin_s, current.terms, section)

    def _tune(
        self, current: Fit, white: Whitening, searched: list[Term], responses: list[Array], direct: list[Array]
    ) -> list[int]:
        """Put orders and frequencies, in place, where responses fit best, and simulate those anew that moved; return
        the places of those that were looked at.

        responses, direct: raw, (1 or 2, signals, n) each, of the searched and the other candidates. The peak of a
        spectrum is beside the right order where the machine answers more strongly at another speed; a fit started there
        ends in a minimum beside it. One that explains little, or far less than something else does, is none of the next
        to be added, and its order or frequency may come from what that one leaves: it is not looked at.
        """
        residual = self.trained(white.apply(current.residual))
        gains = [0.0]
        for column in (column for response in [*direct, *responses] for column in response):
            whitened = self.trained(white.apply(column))
            gains.append(float(np.vdot(whitened, residual)) ** 2 / max(float(np.vdot(whitened, whitened)), 1e-300))
        looked_at, moved = [], []
        for k, response in enumerate(responses):
            tuned, gain = self.proposer.tuned(searched[k], residual, self.trained(white.apply(response)), self._every)
            if gain < max(_OF_ITS_PRICE * price([tuned], self.samples), _OF_THE_BEST * max(gains)):
                continue
            looked_at.append(k)
            if tuned != searched[k]:
                searched[k] = tuned
                moved.append(k)
        anew = self.space.strengths(current.terms, current.residual, [searched[k] for k in moved])
        for k, response in zip(moved, anew, strict=True):
            responses[k] = response
        return looked_at

    def _at_whole_orders(self, searched: list[Term]) -> list[Term]:
        """The searched orders at the nearest whole ones as well, from where a fit may go on.

        An axis that goes to and fro over the same turns, and a ripple that shows in a few far apart, have an order with
        side peaks, and a loop answers in another phase at every speed: neither the spectrum nor one response says which
        of them it is.
        """
        found: dict[tuple[Key, float], Term] = {}
        for term in searched:
            for whole in self.proposer.at_whole_orders(term):
                (name,) = whole.held
                found.setdefault((whole.key, whole.values[name]), replace(whole, held=frozenset()))
        return list(found.values())

    def masked(self, values: Array) -> Array:
        """Values (…, n) with zeros in the rows that do not count."""
        return np.where(self.rows, values, 0.0)

    def trained(self, values: Array) -> Array:
        """Values (…, n) with zeros in the rows that fits do not see."""
        return np.where(self.space.split.train, values, 0.0)

    def carried_over(self, current: Fit, offered: CandidateSet) -> CandidateSet:
        """An older set at another model: responses hardly change, the residual does."""
        kept = [k for k, t in enumerate(offered.candidates) if not any(map(t.overlaps, current.terms))]
        own = self.space.point(current.terms, current.residual).derivatives
        candidates, responses = [offered.candidates[k] for k in kept], [offered.responses[k] for k in kept]
        return CandidateSet(offered.whitening, current.residual, own, candidates, responses)

    def is_rough(self, current: Fit) -> bool:
        """True if far more than noise is left, so that the right model was not found."""
        predictor = self.space.predictor
        floors = {k: _ROUGH * predictor.floor(k) for k in torques_of(predictor)}
        return exceeds_noise(current.residual, self.rows, floors)

    def promises(self, offered: CandidateSet) -> bool:
        """True if anything is left that a candidate could explain, or that none can."""
        if self.ranked(offered, offered.residual, offered.own):
            return True
        whitened = self.masked(offered.whitening.apply(offered.residual))
        counted = float(np.count_nonzero(self.rows))
        excess = (whitened**2).sum(1) / counted - 1.0
        return bool(np.max(excess) > _CALM * np.sqrt(2.0 / counted))

    def _linear(self, offered: CandidateSet, residual: Array, own: Array) -> StretchedProblem:
        """The linear problem of a raw residual (signals, n) in the terms' own columns (J, signals, n) and those of the
        candidates, on the rows that fits see."""
        train = self.space.split.train
        columns = np.concatenate([own[..., train], *(response[..., train] for response in offered.responses)])
        whitened = offered.whitening.apply(residual)[:, train]
        return StretchedProblem.of(whitened, offered.whitening.apply(columns), ridge=_RIDGE)

    # -- additions ---------------------------------------------------------------------------------------

    def best_addition(self, current: Fit, offered: CandidateSet) -> Fit | None:
        """The best fit with one or two terms more; None where none lowers the criterion and holds out.

        Where the best of those that promise most explains only a part, a single one of the next may explain all: one
        whose law is far from linear promises less than it keeps.
        """
        contenders = self.ranked(offered, offered.residual, offered.own)
        best = self._best_of(current, offered, contenders)
        if current.terms or (best is not None and not self.is_rough(best)):
            return best
        more = self.ranked(offered, offered.residual, offered.own, _CONTENDERS + _NEXT)
        singles = [terms for terms in more if len(terms) == 1 and terms not in contenders]
        alone = self._best_of(current, offered, singles)
        return best if alone is None or self.is_rough(alone) else alone

    def _best_of(self, current: Fit, offered: CandidateSet, additions: list[list[Term]]) -> Fit | None:
        """The best full fit with one of the additions that lowers the criterion and that the held-out rows confirm.

        Each fit has to promise to beat the best so far, or it is left unfinished.
        """
        train, test = sums(self.space, offered.whitening, current.residual)
        before = train + price(current.terms, self.samples)
        fits: list[Fit] = []
        least = before
        for chosen in additions:
            terms = [*current.terms, *(self._aimed(term, fits) for term in chosen)]
            cost = price(terms, self.samples)
            found = fit(self.space, offered.whitening, terms, worth=least + MARGIN - cost)
            fits.append(found)
            least = min(least, found.train + cost)
        # Among those that the training rows speak for all rows decide: a time may lie in a stretch that was held out.
        for found in sorted(fits, key=self.criterion):
            better = found.train + price(found.terms, self.samples) < before
            if better and self._is_confirmed(offered.whitening, current, test, found):
                return found
        return None

    @staticmethod
    def _aimed(term: Term, fits: list[Fit]) -> Term:
        """The term at the time that one of the fits has found for it, if it was looked for near its own."""
        for found in fits:
            for other in found.terms:
                if other.aimed and other.key == term.key and abs(other.time_s - term.time_s) < TIME_SEARCH[0]:
                    return other.of_strength(term.coordinates()[: term.linear])
        return term

    def _is_confirmed(self, white: Whitening, current: Fit, test: float, found: Fit) -> bool:
        """True if rows that no fit has seen speak for an addition, too.

        Where it hardly shows on the held-out rows (creep speed that came once, say) they can't decide. Then what was
        found in either half of the rows on which it shows has to hold in the other half.
        """
        rows = self.space.split
        change = white.apply(current.residual - found.residual)
        if float(np.sum(change[:, rows.test] ** 2)) > _OBSERVABLE:
            return _is_beyond_chance(test - found.test)
        change, residual = change[:, rows.train], white.apply(current.residual)[:, rows.train]
        along, square = np.sum(change * residual, axis=0), np.sum(change**2, axis=0)
        middle = int(np.searchsorted(np.cumsum(square), 0.5 * np.sum(square)))
        early, late = slice(None, middle), slice(middle, None)
        gain = 0.0
        for one, other in ((early, late), (late, early)):
            size = float(np.sum(along[one])) / max(float(np.sum(square[one])), 1e-300)
            gain += size * (2.0 * float(np.sum(along[other])) - size * float(np.sum(square[other])))
        return _is_beyond_chance(gain)

    def ranked(
        self, offered: CandidateSet, residual: Array, own: Array, most: int | None = None, least: float = _PROMISING
    ) -> list[list[Term]]:
        """Candidates, and pairs, that promise most, and by `least` more than their price; with start values.

        residual: raw (signals, n); own: raw columns (J, signals, n) of the terms that are there; most: so many single
        ones. By default a few, of those that promise the same the first: what these data can't distinguish at all would
        fill all seats, and is looked at among the alternatives.
        """
        problem, mine = self._linear(offered, residual, own), list(range(len(own)))
        base, _ = problem.left(mine)
        members, samples = offered.members(len(mine)), self.samples

        def promised_by(*chosen: int) -> list[tuple[float, list[Term]]]:
            started = self._started(problem, mine, *(members[k] for k in chosen))
            return [] if started is None else [(base - started[0] - price(started[1], samples), started[1])]

        singles = [(score, k, terms) for k in range(len(members)) for score, terms in promised_by(k)]
        singles.sort(key=lambda item: -item[0])
        chosen: list[list[Term]] = []
        places: set[Place] = set()
        promised: list[float] = []
        for score, _, terms in singles:
            if score <= least or len(chosen) >= (_CONTENDERS if most is None else most):
                break
            place = terms[0].place
            alike = most is None and any(abs(score - other) < _SAME_PROMISE for other in promised)
            if place not in places and not alike:  # variants of one effect at one place would fill all seats
                places.add(place)
                promised.append(score)
                chosen.append(terms)
        # Two effects that only together explain anything (friction against an offset) are never found one by one.
        both = combinations([k for _, k, _ in singles[:_PAIRED_FROM]], 2)
        pairs = [found for a, b in both if members[a][0].key != members[b][0].key for found in promised_by(a, b)]
        pairs.sort(key=lambda item: -item[0])
        best = max((score for score, _, _ in singles), default=0.0)
        # Here, too, variants of two effects at their places would fill all seats.
        together: dict[frozenset[Place], list[Term]] = {}
        for score, terms in pairs:
            if score > max(best, 0.0) + TIED:
                together.setdefault(frozenset(term.place for term in terms), terms)
        return chosen + list(together.values())[:_PAIRS]

    @staticmethod
    def _started(
        problem: StretchedProblem, mine: list[int], *members: tuple[Term, list[int]]
    ) -> tuple[float, list[Term]] | None:
        """Residual sum of squares of some candidates together, and their start values; None where a bound forbids their
        sign.

        mine: columns of the terms that are there; members: candidates that are added, each with its columns.
        """
        columns = [column for _, group in members for column in group]
        if any(problem.raw[column] < _LEAST_INFORMATION for column in columns):
            return None
        if len(members) > 1 and any(
            problem.own_share(column, [*mine, *(other for other in columns if other not in group)]) < _OWN_SHARE
            for _, group in members
            for column in group
        ):
            return None
        _, theta = problem.left([*mine, *columns])
        at, terms = len(mine), []
        for candidate, group in members:
            if candidate.probe is not None:
                # Its response was looked at with one strength, and speaks for others near it only.
                theta[at] = np.clip(theta[at], candidate.probe / _TRUSTED, candidate.probe * _TRUSTED)
            strength = candidate.neutral().coordinates()[: candidate.linear] + theta[at : at + len(group)]
            at += len(group)
            if not candidate.allowed(float(strength[0])):
                return None
            terms.append(candidate.of_strength(strength))
        return problem.left_with([], [*mine, *columns], theta), terms

    def continued(self, best: Fit, offered: CandidateSet) -> tuple[Fit, CandidateSet, bool]:
        """Fitted again; responses hardly change by a term more, and only where they promise something are they
        simulated anew."""
        current = self.again(best, offered.whitening) if self.space.settle(best.terms) else best
        offered = self.carried_over(current, offered)
        unseen = self.space.split_again(current.residual)
        if not (unseen or self.promises(offered)):
            return current, offered, False
        current = self.again(current, offered.whitening)
        return current, self.candidates(current, self.carried_over(current, offered)), True

    # -- earlier choices ---------------------------------------------------------------------------------

    def pruned(self, current: Fit, white: Whitening) -> Fit:
        """The fit without the terms that the others have made superfluous, one by one, the worst first."""
        while len(current.terms) > 1:
            here = current.train + price(current.terms, self.samples)
            fewer = []
            for k in range(len(current.terms)):
                rest = current.terms[:k] + current.terms[k + 1 :]
                # Only then a fit without it is worth its time; linearized, so believed with a factor of four to spare.
                if current.wald(k) < 4.0 * price([current.terms[k]], self.samples):
                    found = fit(self.space, white, rest, worth=here - price(rest, self.samples))
                    fewer.append((found.train + price(rest, self.samples), found))
            better = min(fewer, key=lambda item: item[0], default=None)
            if better is None or better[0] > here:
                break
            current = better[1]
        return current

    # -- alternatives ---------------------------------------------------------------------------------------

    def judged(self, current: Fit, offered: CandidateSet) -> Selection:
        """Each term against its alternatives."""
        # What is not explained would be spread over the alternatives of every term: they would all seem tied.
        if self.is_rough(current):
            return Selection(current, offered)
        current, tied, evidence = self.tested(current, offered)
        better = self._against_forces(current, offered, tied)
        return Selection(current, offered, tied, evidence, better=better)

    def tested(
        self, current: Fit, offered: CandidateSet
    ) -> tuple[Fit, dict[Key, list[Place]], dict[Key, dict[str, float]]]:
        """Test each term against its alternatives: the fit, what is tied with each term, and the evidence.

        When a term turns out to be superfluous, or something else explains more, everything is tested again from there:
        the evidence of each term is conditional on the others.
        """
        tied: dict[Key, list[Place]] = {}
        evidence: dict[Key, dict[str, float]] = {}
        # With a quarter of the tolerances, and on all rows: between good explanations small things decide.
        fine = scaling(deviations_of(self.space.predictor, 0.25))
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

    def _against_forces(self, current: Fit, offered: CandidateSet, tied: dict[Key, list[Place]]) -> Misfit | None:
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
                # What pulls at the last roller shows in its torque.
                signal = self.space.predictor.names[torques_of(self.space.predictor)[-1]]
                return Misfit(signal, lookalike.name, detail, 0.0, 0.0, "always")
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
        tried: list[tuple[float, float, float]] = []

        def square(time_s: float) -> float:
            pushed = space.residual_with_force(rest, probe_N, float(time_s))
            response = white.apply(point.residual - pushed)[:, rows].ravel() / probe_N
            columns = np.array([*own, response])
            theta, *_ = np.linalg.lstsq(columns.T, residual, rcond=None)
            tried.append((float(np.sum((residual - theta @ columns) ** 2)), float(theta[-1]), float(time_s)))
            return tried[-1][0]

        bounds = np.maximum(term.time_s + 0.5 * term.duration_s + _FORCE_SEARCH[0] * np.array([-1.0, 1.0]), 0.0)
        minimize_scalar(square, bounds=bounds.tolist(), method="bounded", options={"xatol": _FORCE_SEARCH[1]})
        least, force_N, time_s = min(tried)
        return least - sum(sums(space, white, current.residual)), force_N, time_s

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
