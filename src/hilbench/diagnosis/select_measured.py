"""Which terms the data ask for where a right model would not leave noise alone: prediction on measured motion.

There the torque is nearly linear in every strength, so that one Gram matrix tells what any term explains beside any
others. What is left at the end is never noise; its spectrum is taken for one (`hilbench.diagnosis.rest`). A term is
certain when

- it is neutral by less than a small chance, with the spectrum of what is left beside it as noise,
- it lowers the sum of squares of what is left by more than a share: what is significant and tiny is a part of the
  expansion of something else, and comes and goes from one recording to the next,
- stretches that did not take part in the fit agree.

The simple effects come first (marginality, Nelder 1977): a law of higher order is read beside those that it is made of.

How often that is right: tools/diagnose_rigs.py, docs/diagnosis.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.fit import Fit, fit
from hilbench.diagnosis.noise import Whitening, scaling
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.rest import Uncertainty, uncertainty
from hilbench.diagnosis.select import CandidateSet, Selection
from hilbench.diagnosis.space import Space, noise_model
from hilbench.diagnosis.terms import Key, Place, Term
from hilbench.plant.effects import EFFECTS

Array = NDArray[np.float64]
Announce = Callable[[str, float], None]

_MOST_TERMS: Final = 10
#: Chance up to which a term that is neutral may be found all the same, over all places that it was searched for at.
_CHANCE: Final = 1e-3
#: Share below which the chance has to be smaller in proportion: what explains little has to be the surer.
_LARGE_SHARE: Final = 0.25
#: Share of the sum of squares that is left without a term by which the term has to lower it; half of it on stretches
#: that no fit has seen; and the share from which one stays.
_LEAST_SHARE, _STAYING_SHARE = 0.06, 0.04
#: The same of a simple effect, without which no other is read aright.
_LEAST_SIMPLE_SHARE: Final = 0.01
#: Contiguous stretches, each of which is predicted from the others.
_STRETCHES: Final = 8
#: Share of what is left by which two explanations may differ and be tied, and by which one has to be better.
_TIED: Final = 0.03
#: Share of a response that those of the present terms leave of it, below which it says nothing of its own.
_OWN_SHARE: Final = 0.01
#: Ratio from which one of two tied explanations is clearly more its own, or less unusual.
_CLEARLY: Final = 1.5
_RANK: Final = {effect.id: place for place, effect in enumerate(EFFECTS)}
#: Orders or frequencies from a present one up to which others are its side bands; how many of them on either side.
_NEAR: Final = 0.5
_MOST_SIDE_BANDS: Final = 20.0
#: Share of what any order explains from which a whole one is named instead.
_WHOLE: Final = 0.75
#: Standard deviation of the torque's size over its mean from which it changes by enough to tell what goes with it.
_CHANGING: Final = 0.5
#: Standard deviations by which what a narrower band finds may differ.
_APART: Final = 3.5
#: Share of a strength by which two bands or stretches may differ however sure they are: a filter rounds what turns.
_SAME_SIZE: Final = 0.03
#: Additions that are fitted in full at a step.
_CONTENDERS: Final = 6


@dataclass(frozen=True)
class _Linear:
    """Least squares of a residual by columns, from Gram matrices of stretches (G, J, J), (G, J) and (G,)."""

    gram: Array
    cross: Array
    square: Array
    raw: Array  #: (J,) squares of the columns, as they are without all that is beside them

    @classmethod
    def of(cls, residual: Array, columns: Array, raw: Array | None = None) -> _Linear:
        """residual (signals, n), columns (J, signals, n), rows that count only; raw: by default their squares."""
        edges = np.linspace(0, residual.shape[-1], _STRETCHES + 1).astype(int)
        gram, cross, square = [], [], []
        for low, high in pairwise(edges):
            c = columns[:, :, low:high].reshape(len(columns), -1)
            r = residual[:, low:high].ravel()
            gram.append(c @ c.T)
            cross.append(c @ r)
            square.append(float(r @ r))
        whole = np.sum(columns**2, axis=(1, 2)) if raw is None else raw
        return cls(np.array(gram), np.array(cross), np.array(square), whole)

    def left(self, chosen: list[int]) -> tuple[float, Array]:
        """Sum of squares that is left by these columns, and their coordinates."""
        theta = _solved(self.gram.sum(0), self.cross.sum(0), chosen)
        return float(self.square.sum() - theta @ self.cross.sum(0)[chosen]), theta

    def left_with(self, chosen: list[int], more: list[int], known: Array) -> float:
        """Sum of squares that is left by some columns fitted and more of them with known coordinates."""
        gram, cross = self.gram.sum(0), self.cross.sum(0)
        square = float(self.square.sum() - 2.0 * known @ cross[more] + known @ gram[np.ix_(more, more)] @ known)
        beside = cross - gram[:, more] @ known
        return float(square - _solved(gram, beside, chosen) @ beside[chosen])

    def left_unseen(self, chosen: list[int]) -> float:
        """The same, each stretch predicted from the others."""
        gram, cross, total = self.gram.sum(0), self.cross.sum(0), 0.0
        for g, c, s in zip(self.gram, self.cross, self.square, strict=True):
            theta = _solved(gram - g, cross - c, chosen)
            total += float(s - 2.0 * theta @ c[chosen] + theta @ g[np.ix_(chosen, chosen)] @ theta)
        return total

    def gain_by_stretch(self, mine: list[int], group: list[int]) -> float:
        """Fall of the sum of squares by more columns with coordinates of their own in every stretch.

        A loop answers in another phase in each direction and at each speed; the order is the same.
        """
        _, theta = self.left(mine)
        gain = 0.0
        for g, c in zip(self.gram, self.cross, strict=True):
            along = c - g[:, mine] @ theta
            gain += float(_solved(g, along, group) @ along[group])
        return gain

    def gain_unseen_in_phase(self, mine: list[int], group: list[int]) -> float:
        """The same by a wave's two columns with the amplitude that the other stretches have and a phase of its own:
        where phase is a state of the machine only the amplitude can be predicted."""
        gram, cross, gain = self.gram.sum(0), self.cross.sum(0), 0.0
        for g, c in zip(self.gram, self.cross, strict=True):
            others = _solved(gram - g, cross - c, [*mine, *group])
            amplitude = float(np.linalg.norm(others[len(mine) :]))
            along = c - g[:, mine] @ others[: len(mine)]
            here = _solved(g, along, group)
            here *= amplitude / max(float(np.linalg.norm(here)), 1e-300)
            gain += float(2.0 * here @ along[group] - here @ g[np.ix_(group, group)] @ here)
        return gain

    def own_share(self, column: int, beside: list[int]) -> float:
        """Share of a column's square that these others leave of it."""
        gram = self.gram.sum(0)
        whole = float(self.raw[column])
        if whole <= 0.0:
            return 0.0
        explained = _solved(gram, gram[column], beside) @ gram[column][beside]
        return (float(gram[column, column]) - float(explained)) / whole


def _basis(columns: Array) -> Array:
    """Orthonormal rows that span the same as these (J, n)."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=1), 1e-300)[:, None]
    _, sizes, vectors = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(vectors[sizes > 1e-6 * float(sizes[0])])


def _without(columns: Array, basis: Array) -> Array:
    """Columns (J, signals, n) without what they have of the rows of a basis (B, signals·n)."""
    flat = columns.reshape(len(columns), -1)
    return np.asarray((flat - (flat @ basis.T) @ basis).reshape(columns.shape))


def _solved(gram: Array, cross: Array, chosen: list[int]) -> Array:
    if not chosen:
        return np.empty(0)
    part = gram[np.ix_(chosen, chosen)]
    scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
    normal = part / np.outer(scale, scale) + 1e-9 * np.eye(len(chosen))
    return np.asarray(np.linalg.solve(normal, cross[chosen] / scale) / scale)


def fitted(space: Space, terms: list[Term]) -> Fit:
    """The terms fitted to all rows that count, every frequency of the band with the same weight."""
    return fit(space, weights(space, terms), terms, space.predictor.rows)


def weights(space: Space, terms: list[Term]) -> Whitening:
    """Of each signal: by what a model with the terms leaves of it."""
    residual = space.residual(terms)[:, space.predictor.rows]
    return scaling(np.maximum(np.std(residual, axis=-1), 1e-300))


def uncertainty_of(space: Space, found: Fit, rows: NDArray[np.bool_] | None = None) -> Uncertainty:
    """Of a fit's coordinates, with what it leaves as noise; rows (n,) of the fit, by default all that count."""
    rows = space.predictor.rows if rows is None else rows
    derivatives = space.point(found.terms, found.residual).derivatives
    return uncertainty(derivatives[..., rows], found.residual[..., rows])


class MeasuredSearch:
    """The search over one space."""

    def __init__(self, space: Space, proposer: Proposer, announce: Announce) -> None:
        self._space, self._proposer, self._announce = space, proposer, announce
        self._rows = space.predictor.rows

    def run(self) -> Selection:
        """Add what explains more than a small share, the simple first; then drop what is not certain beside all others.

        Beside a gross error of the model nothing is certain, so that comes last.
        """
        current = self._fitted([])
        offered = self._offered(current)
        for depth in range(_MOST_TERMS):
            self._announce(f"step {depth + 1}: {len(offered.candidates)} candidates", 0.1 + 0.7 * depth / _MOST_TERMS)
            found = self._with_one_more(current, offered)
            if found is None:
                break
            current = found
            offered = self._offered(current)
        steady = self._in_both_halves(self._in_every_band(current))
        wandering = {term.place for term in current.terms} - {term.place for term in steady.terms}
        certain = self._without_superfluous(steady)
        if len(certain.terms) < len(current.terms):
            offered = self._offered(certain)
        current = certain
        self._announce("what else could explain it", 0.85)
        tied = self._tied(current, offered, wandering)
        plainer = self._with_first_of_alike(current, tied, offered)
        if plainer is not current:
            current, offered = plainer, self._offered(plainer)
            tied = self._tied(current, offered, wandering)
        samples = float(np.count_nonzero(self._rows) * len(self._space.predictor.names))
        return Selection(current, offered, samples, tied, self._evidence(current))

    # -- fits ----------------------------------------------------------------------------------------------

    def _fitted(self, terms: list[Term]) -> Fit:
        return fitted(self._space, terms)

    def _counted(self, values: Array) -> Array:
        """Rows of (…, signals, n) that count."""
        return values[..., self._rows]

    def _uncertainty(self, current: Fit) -> Uncertainty:
        return uncertainty_of(self._space, current)

    def _left_beside(self, found: Fit, current: Fit) -> float:
        """Sum of squares without the side bands of what was there before."""
        return float(np.sum(self._counted(self._beside(found, self._side_bands(current))) ** 2))

    # -- candidates ----------------------------------------------------------------------------------------

    def _offered(self, current: Fit) -> CandidateSet:
        """Every candidate with its response; orders and frequencies from the residual's spectrum."""
        space = self._space
        candidates = [t for t in self._proposer.plain() if not any(map(t.overlaps, current.terms))]
        responses = space.strengths(current.terms, current.residual, candidates)
        own = space.point(current.terms, current.residual).derivatives
        white = noise_model(space, current.residual, np.concatenate([own, *responses]))
        searched = self._searched(current, white)
        more = space.strengths(current.terms, current.residual, searched)
        return CandidateSet(white, current.residual, own, candidates + searched, responses + more)

    def _searched(self, current: Fit, white: Whitening) -> list[Term]:
        """Orders and frequencies from the residual's spectrum, as it is and whitened, beside those that are there.

        Where a turn is resolved the whole number of times a turn that is nearest is offered as well: what turns has
        such orders, and a drive's loop that answers in another phase in each direction splits their peak.
        """
        found: list[Term] = []
        beside = self._beside(current, self._side_bands(current))
        for apply in (lambda values: values, white.apply):
            left = self._masked(apply(beside))
            named = dict(zip(self._space.predictor.names, left, strict=True))
            terms = self._proposer.searched(named, current.terms, self._space.predictor.every)
            responses = self._space.strengths(current.terms, current.residual, terms)
            for term, response in zip(terms, responses, strict=True):
                masked = self._masked(apply(response))
                found.append(self._proposer.tuned(term, left, masked, self._space.predictor.every))
        found = [term for term in found if not self._is_near_present(term, current)]
        return found + [whole for term in found for whole in self._proposer.at_whole_orders(term)]

    def _side_bands(self, current: Fit) -> Array:
        """Waves (J, signals, n) near the orders and frequencies of the present terms.

        A loop answers to an order in another phase at every speed and in each direction. What that leaves of the order
        is neither an order beside it nor anything else. Where an axis goes there and back each wave has another size
        and phase either way.
        """
        columns = []
        for term in current.terms:
            name, angle = self._proposer.searched_angle_rad(term, self._space.predictor.every)
            if name is None:
                continue
            turns = float(np.ptp(angle)) / (2.0 * np.pi)
            step = max(0.5 / turns, _NEAR / _MOST_SIDE_BANDS)
            offsets = step * np.arange(-int(_NEAR / step), int(_NEAR / step) + 1)
            waves = np.exp(1j * np.outer(term.values[name] + offsets, angle))
            both = np.concatenate([waves.real, waves.imag])
            columns.append(both)
            forward = np.gradient(angle) > 0.0
            if term.axis is not None and np.any(forward[self._rows]) and not np.all(forward[self._rows]):
                columns.append(np.where(forward, both, -both))
        signals, n = current.residual.shape
        if not columns:
            return np.empty((0, signals, n))
        found = np.concatenate(columns)
        return np.concatenate([found[:, None, :] * np.eye(signals)[k][None, :, None] for k in range(signals)])

    def _beside(self, current: Fit, side_bands: Array) -> Array:
        """The residual (signals, n) without the side bands."""
        residual = current.residual.copy()
        if len(side_bands):
            columns = self._counted(side_bands).reshape(len(side_bands), -1)
            theta, *_ = np.linalg.lstsq(columns.T, self._counted(residual).ravel(), rcond=1e-6)
            residual -= np.tensordot(theta, side_bands, 1)
        return residual

    def _is_near_present(self, term: Term, current: Fit) -> bool:
        if not term.has_phase:
            return False
        return any(other.has_phase and abs(self._order(other) - self._order(term)) < _NEAR for other in current.terms)

    def _masked(self, values: Array) -> Array:
        """Values (…, n) with zeros in the rows that do not count."""
        return np.where(self._rows, values, 0.0)

    def _linear(
        self, residual: Array, own: Array, offered: CandidateSet, beside: Array | None = None
    ) -> tuple[_Linear, list[list[int]]]:
        """The linear problem of the terms' own columns and of the candidates; which columns are each candidate's.

        beside: columns (J, signals, n) of which nothing is looked at: taken out of all the others beforehand, because
        what one stretch has of them the others don't tell.
        """
        columns = self._counted(np.concatenate([own, *offered.responses]))
        counted = self._counted(residual)
        raw = np.sum(columns**2, axis=(1, 2))
        if beside is not None and len(beside):
            basis = _basis(self._counted(beside).reshape(len(beside), -1))
            columns, counted = _without(columns, basis), _without(counted[None], basis)[0]
        groups, at = [], len(own)
        for response in offered.responses:
            groups.append(list(range(at, at + len(response))))
            at += len(response)
        return _Linear.of(counted, columns, raw), groups

    # -- additions ---------------------------------------------------------------------------------------

    def _with_one_more(self, current: Fit, offered: CandidateSet) -> Fit | None:
        """The fit with the candidate that explains most of those that are certain; the simple ones go first."""
        problem, groups = self._linear(offered.residual, offered.own, offered, self._side_bands(current))
        mine = list(range(len(offered.own)))
        before, before_unseen = problem.left(mine)[0], problem.left_unseen(mine)
        waves = [
            (term, self._wave_gain(problem, mine, group))
            for term, group in zip(offered.candidates, groups, strict=True)
            if term.has_phase
        ]
        offers = []
        for term, group in zip(offered.candidates, groups, strict=True):
            started = self._started(problem, mine, term, group)
            least = _least_share(term)
            if started is None or before - started[0] < least * before:
                continue
            if term.has_phase:
                unseen = problem.gain_unseen_in_phase(mine, group)
            else:
                unseen = before_unseen - problem.left_unseen([*mine, *group])
            if unseen < 0.5 * least * before_unseen:
                continue
            if term.has_phase:
                free = self._wave_gain(problem, mine, group)
                if any(self._is_as_good_a_wave(other, gain, term, free) for other, gain in waves):
                    continue
            free = problem.gain_by_stretch(mine, group) if term.has_phase else 0.0
            offers.append(_Offer(started[1], started[0], problem.own_share(group[0], mine), free))
        offers = [offer for offer in offers if not _is_beside_a_whole_order(offer, offers)]
        for offer in _in_order(offers)[:_CONTENDERS]:
            found = self._fitted([*current.terms, offer.term])
            if self._left_beside(found, current) < (1.0 - _least_share(offer.term)) * before:
                return found
        return None

    def _wave_gain(self, problem: _Linear, mine: list[int], group: list[int]) -> float:
        """What a wave explains with free phases; where the size of the torque hardly changes with free amplitudes, too.

        There what goes with the torque, and what goes with the direction, are one.
        """
        sizes = np.abs(self._counted(self._space.predictor.measured))
        if np.all(np.std(sizes, axis=-1) < _CHANGING * np.mean(sizes, axis=-1)):
            return problem.gain_by_stretch(mine, group)
        return problem.gain_unseen_in_phase(mine, group)

    def _is_as_good_a_wave(self, other: Term, gain: float, wave: Term, its: float) -> bool:
        """Whether a simpler wave of the same order explains nearly as much when phases are free.

        A loop that answers in another phase in each direction makes a wave look like one that goes with the torque.
        """
        if not wave.has_phase or _RANK[other.effect.id] >= _RANK[wave.effect.id]:
            return False
        return abs(self._order(other) - self._order(wave)) < _NEAR and gain >= _WHOLE * its

    def _order(self, wave: Term) -> float:
        """Times a turn of the motor; once a turn of what it drives where the law has no order."""
        name, _ = self._proposer.searched_angle_rad(wave, self._space.predictor.every)
        if name is not None:
            return wave.values[name]
        return 1.0 if wave.axis is None else 1.0 / self._space.model.gear_ratio(wave.axis)

    @staticmethod
    def _started(problem: _Linear, mine: list[int], term: Term, group: list[int]) -> tuple[float, Term] | None:
        """What a candidate would leave, and its start values; None where it says nothing of its own or no bound allows
        its sign."""
        if min(problem.own_share(column, mine) for column in group) < _OWN_SHARE:
            return None
        left, theta = problem.left([*mine, *group])
        here = term.neutral().coordinates()
        strength = here[: term.linear] + theta[len(mine) :]
        if not term.allowed(float(strength[0])):
            # A bound is as far as it goes: what it explains there counts.
            bounded = term.at(np.concatenate([strength, here[term.linear :]])).coordinates()[: term.linear]
            if not np.any(bounded - here[: term.linear]):
                return None
            left, strength = problem.left_with(mine, group, bounded - here[: term.linear]), bounded
        return left, term.at(np.concatenate([strength, here[term.linear :]]))

    def _chances(self, found: Fit) -> list[float]:
        """Of each term that it is neutral and was found all the same."""
        known, at, chances = self._uncertainty(found), 0, []
        for term in found.terms:
            moved = term.coordinates()[: term.linear] - term.neutral().coordinates()[: term.linear]
            chances.append(known.chance(slice(at, at + term.linear), moved))
            at += len(term.coordinates())
        return chances

    # -- earlier choices ---------------------------------------------------------------------------------

    def _in_every_band(self, current: Fit) -> Fit:
        """The fit without the terms of which a narrower band finds another size, one by one, the worst first.

        An effect has one size; what stands for something else (a delay for a loop's answer to a ripple) changes with
        the frequencies that are looked at. A wave shows in a narrower band at lower speeds only, and is not judged.
        """
        if self._space.predictor.narrower is None:
            return current
        space = replace(self._space, predictor=self._space.predictor.narrower)
        while current.terms:
            narrow = fitted(space, current.terms)
            apart = _apart(current, narrow, self._uncertainty(current), uncertainty_of(space, narrow))
            worst = int(np.argmax(apart))
            if apart[worst] < _APART:
                break
            current = self._fitted([*current.terms[:worst], *current.terms[worst + 1 :]])
        return current

    def _in_both_halves(self, current: Fit) -> Fit:
        """The fit without the delays that every other stretch finds in another size than those between.

        A cable is as long in every stretch; what a delay stands for (an arm that swings along) is another from motion
        to motion. Of what the model is linear in each stretch was predicted from the others before.
        """
        stretches = np.array_split(np.flatnonzero(self._rows), _STRETCHES)
        halves = []
        for first in (0, 1):
            half = np.zeros(len(self._rows), bool)
            half[np.concatenate(stretches[first::2])] = True
            halves.append(half)
        while any(term.probe is not None for term in current.terms):
            early, late = (
                fit(self._space, weights(self._space, current.terms), current.terms, half) for half in halves
            )
            sure = [uncertainty_of(self._space, found, half) for found, half in zip((early, late), halves, strict=True)]
            apart = _apart(early, late, *sure)
            delays = [size if term.probe is not None else 0.0 for size, term in zip(apart, current.terms, strict=True)]
            worst = int(np.argmax(delays))
            if delays[worst] < _APART:
                break
            current = self._fitted([*current.terms[:worst], *current.terms[worst + 1 :]])
        return current

    def _without_superfluous(self, current: Fit) -> Fit:
        """The fit without the terms that the others have made uncertain, one by one, the least certain first."""
        while current.terms:
            chances, shares = self._chances(current), self._shares(current)
            for k in np.argsort(chances)[::-1]:
                term = current.terms[k]
                least = _STAYING_SHARE / _LEAST_SHARE * _least_share(term)
                chance = _CHANCE / term.multiplicity * min(1.0, shares[k] / _LARGE_SHARE)
                if chances[k] > chance or shares[k] < least:
                    current = self._fitted([*current.terms[:k], *current.terms[k + 1 :]])
                    break
            else:
                break
        return current

    def _shares(self, current: Fit) -> list[float]:
        """By which share each term lowers what is left without it, the others free to adapt.

        Of what is no wave beside the side bands of the waves: a delay makes up for a phase that changes with the speed.
        """
        point = self._space.point(current.terms, current.residual)
        bands = self._side_bands(current)
        shares = []
        for k, first in enumerate(_firsts(current.terms)):
            term = current.terms[k]
            own = list(range(first, first + len(term.coordinates())))
            moved = term.coordinates()[: term.linear] - term.neutral().coordinates()[: term.linear]
            columns = point.derivatives if term.has_phase else np.concatenate([point.derivatives, bands])
            counted = self._counted(columns)
            here = _Linear.of(self._counted(current.residual), counted).left(list(range(len(columns))))[0]
            back = self._counted(current.residual + np.tensordot(moved, point.derivatives[own[: term.linear]], 1))
            without = _Linear.of(back, counted).left([c for c in range(len(columns)) if c not in own])[0]
            shares.append(1.0 - here / max(without, 1e-300))
        return shares

    def _tied(self, current: Fit, offered: CandidateSet, wandering: set[Place]) -> dict[Key, list[Place]]:
        """What could stand in the place of each term and leave as little, but for what no two bands agree on."""
        tied: dict[Key, list[Place]] = {}
        count = len(offered.own)
        problem, groups = self._linear(current.residual, offered.own, offered)
        here = problem.left(list(range(count)))[0]
        for term, first in zip(current.terms, _firsts(current.terms), strict=True):
            own = range(first, first + len(term.coordinates()))
            mine = [c for c in range(count) if c not in own]
            moved = term.coordinates()[: term.linear] - term.neutral().coordinates()[: term.linear]
            # The residual without the term, as far as it is linear in it.
            back = np.tensordot(moved, offered.own[first : first + term.linear], 1)
            without, _ = self._linear(current.residual + back, offered.own, offered)
            tied[term.key] = []
            for other, group in zip(offered.candidates, groups, strict=True):
                if other.place in {term.place, *wandering, *tied[term.key]}:
                    continue
                started = self._started(without, mine, other, group)
                if started is not None and started[0] < (1.0 + _TIED) * here:
                    tied[term.key].append(other.place)
            tied[term.key] += self._alike(current, term, here, offered, {*wandering, *tied[term.key]})
        return tied

    def _alike(
        self, current: Fit, term: Term, left: float, offered: CandidateSet, known: set[Place]
    ) -> Iterator[Place]:
        """Effects of which it is known that some recordings can't tell them from the term's, and these can't.

        Beside the term their responses say nothing of it (what is fed forward goes with an inertia that the term has
        taken away), so each is fitted in its place.
        """
        rest = [other for other in current.terms if other is not term]
        for other in offered.candidates:
            if other.place in known or other.place == term.place or other.axis != term.axis:
                continue
            if other.has_phase or not other.effect.is_alike(term.effect):
                continue
            instead = self._counted(self._fitted([*rest, other]).residual)
            if float(np.sum(instead**2)) < (1.0 + _TIED) * left:
                known.add(other.place)
                yield other.place

    def _with_first_of_alike(self, current: Fit, tied: dict[Key, list[Place]], offered: CandidateSet) -> Fit:
        """The fit with the first in the table of each term and what is alike and tied with it: an inertia that the
        torque lacks is named, not one of the ways in which it may come to lack it."""
        for term in current.terms:
            instead = [
                other
                for other in offered.candidates
                if other.place in tied[term.key] and other.effect.is_alike(term.effect) and not other.has_phase
                if _RANK[other.effect.id] < _RANK[term.effect.id]
            ]
            if instead:
                first = min(instead, key=lambda other: _RANK[other.effect.id])
                found = self._fitted([first if one is term else one for one in current.terms])
                return self._with_first_of_alike(found, {one.key: [] for one in found.terms} | tied, offered)
        return current

    def _evidence(self, current: Fit) -> dict[Key, dict[str, float]]:
        if not current.terms:
            return {}
        judged = zip(current.terms, self._chances(current), self._shares(current), strict=True)
        return {term.key: {"chance_if_neutral": chance, "share_of_rest": share} for term, chance, share in judged}


def _apart(one: Fit, other: Fit, sure: Uncertainty, other_sure: Uncertainty) -> list[float]:
    """By how many standard deviations two fits of the same terms differ in the strength of each, beyond a share of it
    that makes no other effect of it; 0 of a wave."""
    deviations = np.maximum(np.hypot(sure.deviations, other_sure.deviations), 1e-300)
    found = []
    for a, b, k in zip(one.terms, other.terms, _firsts(one.terms), strict=True):
        here, there, neutral = (float(term.coordinates()[0]) for term in (a, b, a.neutral()))
        beyond = abs(here - there) - _SAME_SIZE * abs(here - neutral)
        found.append(0.0 if a.has_phase else max(beyond, 0.0) / float(deviations[k]))
    return found


def _firsts(terms: list[Term]) -> list[int]:
    """The first coordinate of each term among those of all."""
    return [int(first) for first in np.cumsum([0, *(len(term.coordinates()) for term in terms)])[:-1]]


def _is_beside_a_whole_order(offer: _Offer, offers: list[_Offer]) -> bool:
    """Whether a whole order explains nearly as much as one that is not."""
    return not offer.term.held and any(
        other.term.held and other.term.key == offer.term.key and other.in_stretches >= _WHOLE * offer.in_stretches
        for other in offers
    )


def _least_share(term: Term) -> float:
    return _LEAST_SHARE if term.effect.removable else _LEAST_SIMPLE_SHARE


@dataclass(frozen=True)
class _Offer:
    """A term that may be added, with its start values."""

    term: Term
    left: float  #: sum of squares, with it
    own: float  #: share of its response that the present terms leave of it
    in_stretches: float  #: of a wave: what it explains with a phase of its own in every stretch

    @property
    def sizes(self) -> float:
        """How far from neutral it is, in its usual sizes."""
        moved = self.term.coordinates()[: self.term.linear] - self.term.neutral().coordinates()[: self.term.linear]
        return float(np.linalg.norm(moved)) / self.term.size


def _in_order(offers: list[_Offer]) -> list[_Offer]:
    """The simple first, then what leaves least; of those that leave the same, what is named first."""
    waiting = sorted(offers, key=lambda offer: (offer.term.effect.removable, offer.left))
    ordered = []
    while waiting:
        first = waiting[0]
        for other in waiting[1:]:
            if other.left <= (1.0 + _TIED) * waiting[0].left and _is_preferred(other, first):
                first = other
        waiting.remove(first)
        ordered.append(first)
    return ordered


def _is_preferred(other: _Offer, offer: _Offer) -> bool:
    """Whether another explanation that leaves as much is named instead of one.

    The simple one; then the one that changes less of what the present terms explain; then the one that is less unusual
    on such a machine; then the first in the table.
    """
    if other.term.effect.removable != offer.term.effect.removable:
        return not other.term.effect.removable
    for mine, its in ((offer.own, other.own), (1.0 / offer.sizes, 1.0 / other.sizes)):
        if max(mine, its) > _CLEARLY * min(mine, its):
            return its > mine
    return _RANK[other.term.effect.id] < _RANK[offer.term.effect.id]
