"""What changed between two recordings of a web machine.

What the earlier one lacks is found first, then what the later one does beside it; then both are explained together,
which gives the size of each change and its interval.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, Value, concluded, rounded
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.noise import NORMAL_95
from hilbench.diagnosis.predictor import Choice, choice
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.select import Selection, search
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Key, Term, extended, parts
from hilbench.plant.effect import ProbeOver
from hilbench.plant.model_file import Machine

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Announce = Callable[[str, float], None]

#: What belongs to one recording's clock: it is found anew in the other one, or not there.
_BY_THE_CLOCK: Final = (ProbeOver.TIME, ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION)


@dataclass(frozen=True)
class _Side:
    """A recording, the terms found in it beyond its model, and the weights of its residuals."""

    space: Space
    choice: Choice
    data: Measured
    selection: Selection

    @classmethod
    def of(cls, model: Machine, data: Measured, emulation: AnyEmulation | None, announce: Announce) -> _Side:
        chosen = choice(model, data, emulation)
        space = Space(model, chosen.predictor, data.period_s)
        return cls(space, chosen, data, search(space, Proposer(model, data), announce, space.predictor.every))

    @property
    def terms(self) -> list[Term]:
        """Terms that were found."""
        return self.selection.fit.terms

    def linearized(self, terms: list[Term]) -> tuple[Array, Array]:
        """Whitened derivatives (J, rows) by the coordinates of the terms, and the residual, on rows that count."""
        white, rows, point = self.selection.candidates.whitening, self.space.predictor.rows, self.space.point(terms)
        rest = white.apply(point.residual)[:, rows].ravel()
        return white.apply(point.derivatives)[:, :, rows].reshape(len(point.derivatives), len(rest)), rest


def changes(
    model: Machine,
    now: Measured,
    then: Measured,
    emulations: tuple[AnyEmulation | None, AnyEmulation | None],
    announce: Announce,
) -> Diagnosis:
    """Find what differs in `now` from `then`, of a machine that is simulated; `emulations` of both, in that order."""
    before = _Side.of(model, then, emulations[1], lambda text, share: announce(f"before: {text}", 0.4 * share))
    was = extended(model, [term for term in before.terms if not _by_the_clock(term)])
    after = _Side.of(was, now, emulations[0], lambda text, share: announce(f"after: {text}", 0.4 + 0.3 * share))
    found = concluded(after.space, after.choice, now, after.selection, announce)
    if found.verdict == "unknown" and was != model:  # an effect that ended may hide a new one
        alone = _Side.of(model, now, emulations[0], lambda text, share: announce(f"alone: {text}", 0.7 + 0.25 * share))
        other = concluded(alone.space, alone.choice, now, alone.selection, announce)
        if other.verdict != "unknown":
            return _changed(other, _Joint.of(before, alone, kept=False), _lacked(before, before.terms))
    waves = [term for term in before.terms if _by_the_clock(term) and term.has_phase]
    return _changed(found, _Joint.of(before, after, kept=True), _lacked(before, waves))


def _lacked(before: _Side, terms: list[Term]) -> list[NamedEffect]:
    """The effects of some of the earlier recording's terms; what set in at a time of its own is no change that went."""
    places = {term.place for term in terms if term.has_phase or not _by_the_clock(term)}
    if not places:
        return []
    found = concluded(before.space, before.choice, before.data, before.selection, lambda text, share: None)
    return [effect for effect in found.effects if effect.place in places]


def _changed(found: Diagnosis, joint: _Joint, lacked: list[NamedEffect]) -> Diagnosis:
    """The diagnosis of the later recording, with changes for effects; `lacked`: those of the earlier one."""
    here = {effect.place for effect in found.effects}
    gone = [effect for effect in lacked if effect.place not in here]
    effects = [change for effect in [*found.effects, *gone] if (change := joint.change(effect)) is not None]
    verdict = found.verdict if found.verdict == "unknown" else ("named" if effects else "complete")
    return replace(found, effects=effects, verdict=verdict)


def _by_the_clock(term: Term) -> bool:
    return term.effect.probe is not None and term.effect.probe.over in _BY_THE_CLOCK


@dataclass(frozen=True)
class _Joint:
    """Coordinates of the terms of both recordings, explained together, with their covariance."""

    before: dict[Key, Term]
    after: dict[Key, Term]
    places: dict[tuple[str, Key], Rows]  #: of the coordinates of a term, as it is "before" or "after"
    step: Array
    covariance: Array

    @classmethod
    def of(cls, before: _Side, after: _Side, *, kept: bool) -> _Joint:
        """One step of Gauss and Newton from where each was fitted alone.

        kept: whether the model of the later one has what was found in the earlier one; then a term that the later one
        has no value of its own for is the same in both.
        """
        anew = {term.key for term in after.terms}
        shared = [t for t in before.terms if kept and t.key not in anew and not _by_the_clock(t)]
        own = [term for term in before.terms if term not in shared]
        everything = [*shared, *own, *after.terms]
        columns = [(t, np.arange(part.start, part.stop)) for t, part in zip(everything, parts(everything), strict=True)]
        count = sum(len(at) for _, at in columns)
        gram, along, square, samples = np.zeros((count, count)), np.zeros(count), 0.0, 0
        first = len(shared) + len(own)
        for side, chosen in ((before, columns[:first]), (after, [*columns[: len(shared)], *columns[first:]])):
            derivatives, rest = side.linearized([term for term, _ in chosen])
            at = np.concatenate([np.empty(0, np.int64), *(place for _, place in chosen)])
            gram[np.ix_(at, at)] += derivatives @ derivatives.T
            along[at] += derivatives @ rest
            square, samples = square + float(rest @ rest), samples + len(rest)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        places = {("before", term.key): at for term, at in columns[:first]}
        places |= {("after", term.key): at for term, at in columns[first:]}
        return cls(
            {term.key: term for term in before.terms},
            {term.key: term for term in after.terms},
            places,
            inverse @ along,
            inverse * max(square / max(samples, 1), 1.0),
        )

    def change(self, effect: NamedEffect) -> NamedEffect | None:
        """The effect with the size of the change of its strength; None where the interval includes no change."""
        key = next(key for key in [*self.after, *self.before] if key[0] == effect.place)
        term = self.after.get(key) or self.before[key]
        here, was = (self._strength(when, key, term) for when in ("after", "before"))
        covariance = self._difference(key, term.linear)
        if not term.has_phase:
            change, error = float(here[0] - was[0]), float(np.sqrt(max(covariance[0, 0], 0.0)))
        elif _by_the_clock(term):  # its phase is that of another clock: amplitudes are compared
            change = float(np.linalg.norm(here) - np.linalg.norm(was))
            error = float(np.sqrt(max(float(np.max(np.diag(covariance))), 0.0)))
        else:
            change = float(np.linalg.norm(here - was))
            direction = (here - was) / max(change, 1e-300)
            error = float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
        half = NORMAL_95 * error
        if abs(change) <= half:
            return None
        strength = term.effect.strength[0]
        size = Value(
            rounded(change),
            (rounded(change - half), rounded(change + half)),
            term.effect.parameter(strength).unit,
            before=rounded(float(np.linalg.norm(was) if term.has_phase else was[0])),
        )
        return replace(effect, parameters={**effect.parameters, strength: size})

    def _strength(self, when: str, key: Key, term: Term) -> Array:
        """Linear coordinates of a term in one recording; neutral where it was not found."""
        found = (self.after if when == "after" else self.before).get(key)
        if found is None:
            return term.neutral().coordinates()[: term.linear]
        return np.asarray(found.coordinates()[: term.linear] + self.step[self.places[when, key][: term.linear]])

    def _difference(self, key: Key, linear: int) -> Array:
        """Covariance of those of one recording less those of the other."""
        count = len(self.step)
        weights = np.zeros((linear, count))
        for when, sign in (("after", 1.0), ("before", -1.0)):
            if (when, key) in self.places:
                weights[np.arange(linear), self.places[when, key][:linear]] = sign
        return np.asarray(weights @ self.covariance @ weights.T)
