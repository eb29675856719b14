"""The workflow: simulate, locate, propose, add, show the gap shrink, and know the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil, log10
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.coupled_axis import OTHER_HELD, couplings, proposer_for, unidentifiable_beside
from hilbench.diagnosis.data_cleaning import Repair
from hilbench.diagnosis.fed_forward import without_excess, without_oscillation
from hilbench.diagnosis.fit import (
    STATED,
    Fit,
    around,
    fit,
    moved_by_doubts,
    stated_uncertainty,
    sums,
    time_interval_s,
    weights,
)
from hilbench.diagnosis.free_rules import FreeRules
from hilbench.diagnosis.loop_check import nuisance_of
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.measured_rules import first_unseen, lasting_change, settled_beside, unidentifiable_modes
from hilbench.diagnosis.noise import NORMAL_95, Whitening, floor, rms
from hilbench.diagnosis.predictor import Choice, choice, deviations_of, torques_of
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_analysis import (
    Condition,
    Misfit,
    beyond_noise,
    exceeds_noise,
    in_floors,
    located,
    misfits,
)
from hilbench.diagnosis.search import Announce, search
from hilbench.diagnosis.select_measured import MeasuredRules
from hilbench.diagnosis.selection import Selection
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.sparse_law import SparseLaw, law
from hilbench.diagnosis.terms import Place, Term, extended, parts
from hilbench.plant.effect import Section
from hilbench.plant.model_file import Machine
from hilbench.results.recording import Recording

#: An effect is invisible when a change of its usual size is below so many standard deviations.
_VISIBLE: Final = 5.0
#: Rms of what is left up to which effects are named where a right model need not leave white noise, as a share of the
#: measured torque's rms. The laws that are published of servo axes leave 2 to 6 % of it.
LARGEST_REST: Final = 0.1
#: How far around a time its interval is looked for at first, s.
_PROFILE_S: Final = 0.3
_ROWS_OF_WHERE: Final = 8
#: Orders, in turns of the motor, of which it is said from which on these data can't show a ripple.
_ORDERS: Final = (1.0, 2.0, 4.0, 6.0)
_PROFILES: Final = 4
_DIGITS: Final = 8
_LEAST_DIGITS: Final = 5


@dataclass(frozen=True)
class Value:
    """A parameter's estimate, or its change, with its 95 % interval."""

    value: float
    ci95: tuple[float, float]
    unit: str
    before: float | None = None  #: of a change, what it was in the recording before

    @classmethod
    def of(cls, value: float, ci95: tuple[float, float], unit: str, before: float | None = None) -> Value:
        """Value rounded to as many digits as any interval needs."""
        low, high = ci95
        was = None if before is None else rounded(before)
        return cls(rounded(value), (rounded(low), rounded(high)), unit, was)

    @property
    def digits(self) -> int:
        """Significant digits needed to distinguish the ends of the interval, 5 at least."""
        low, high = self.ci95
        largest = max(abs(low), abs(high))
        if not 0.0 < high - low <= largest:
            return _LEAST_DIGITS
        return max(_LEAST_DIGITS, min(ceil(log10(largest / (high - low))) + 2, _DIGITS))


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was found."""

    effect: str
    axis: int | None
    parameters: dict[str, Value]
    evidence: dict[str, float]
    tied_with: list[str] = field(default_factory=list)
    told_apart_by: str | None = None
    section: Section | None = None  #: the span of several; None: in all of them

    @property
    def place(self) -> Place:
        """Place of the effect."""
        return Place(self.effect, self.axis, self.section)


@dataclass(frozen=True)
class Gap:
    """Rms of one signal's residual on stretches that no fit has seen."""

    signal: str
    before: float
    after: float
    noise_floor: float
    unit: str


@dataclass(frozen=True)
class GapLocation:
    """One row of the table of disagreements of the original model."""

    signal: str
    when: str
    condition: str
    share_of_gap: float


@dataclass(frozen=True)
class Profile:
    """Mean residual of a torque, N·m, over a state, with the original model and with the effects that were found."""

    signal: str
    condition: str
    unit: str  #: of the condition
    at: Array  #: (bins,)
    before: Array
    after: Array


@dataclass(frozen=True)
class Unobservable:
    """An effect that these data could not show at its usual size."""

    effect: str
    axis: int | None
    smallest_visible: float | None
    unit: str
    experiment: str
    section: Section | None = None
    order: float | None = None  #: of a wave, the lowest of those that were looked at from which on it can't be seen
    frequency_Hz: float | None = None  #: the same of a resonance

    @classmethod
    def of(cls, term: Term, smallest: float | None, experiment: str, **shape: float) -> Unobservable:
        """Unobservable effect of a term; smallest: strength that could be seen, infinite or None where none could."""
        unit = term.effect.parameter(term.effect.strength[0]).unit
        visible = None if smallest is None or not np.isfinite(smallest) else rounded(float(smallest))
        return cls(term.effect.id, term.axis, visible, unit, experiment, term.section, **shape)

    @property
    def place(self) -> Place:
        """Place where the effect would be."""
        return Place(self.effect, self.axis, self.section)

    @property
    def shape(self) -> dict[str, float]:
        """Known parameters of its shape, in addition to its size."""
        values = {"order": self.order, "frequency_Hz": self.frequency_Hz}
        return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis."""

    verdict: str
    effects: list[NamedEffect]
    gaps: list[Gap]
    where: list[GapLocation]
    profiles: list[Profile]  #: of the signal with the largest gap
    unexplained: list[Misfit]  #: significant dependences of the residual that no effect explains
    unobservable: list[Unobservable]
    missing_channels: list[str]
    model: Machine  #: extended
    names: tuple[str, ...]
    t_s: Array
    before: Array  #: residuals (signals, n)
    after: Array
    held_out: NDArray[np.bool_]
    simulations: int
    emulation: AnyEmulation | None = None  #: how web or shaft was emulated, of a bench's recording
    predicted_on: str = ""  #: what the prediction is driven by, and why, for a person
    nuisance: list[NamedEffect] = field(default_factory=list)  #: found beside the effects and corrected for
    laws: list[SparseLaw] = field(default_factory=list)  #: proposals for what no effect explains, no names
    repairs: list[Repair] = field(default_factory=list)  #: what was wrong with the recording's rows

    @property
    def gap(self) -> Gap:
        """The one that was largest in its own noise floors."""
        return max(self.gaps, key=_size)


def _size(gap: Gap) -> float:
    return gap.before / gap.noise_floor


def diagnose(
    recording: Recording,
    model: Machine,
    place: str | Path,
    announce: Announce = lambda text, share: None,
    emulation: AnyEmulation | None = None,
) -> Diagnosis:
    """Diagnose one recording. Raises UnusableInputError, one line, where it can't be used.

    `emulation`: how the bench emulated web or shaft, if the recording is a bench's; by default as benches do it.
    """
    announce("simulate the model", 0.02)
    return diagnosed(measured_from(recording, model, place), model, announce, emulation)


def diagnosed(
    data: Measured, model: Machine, announce: Announce = lambda text, share: None, emulation: AnyEmulation | None = None
) -> Diagnosis:
    """Diagnose what was taken from a recording."""
    chosen = choice(model, data, emulation)
    if chosen.simpler is not None:
        found = concluded(explained(chosen.simpler, model, data, announce), announce)
        if found.verdict != "unknown":
            return found
    explanation = explained(chosen, model, data, announce)
    for corrected in (without_excess, without_oscillation):
        space = explanation.space
        proposer = proposer_for(space.predictor, model, data)
        if (mended := corrected(space, proposer, explanation.selection, explanation.data)) is not None:
            explanation = explained(choice(model, mended, emulation), model, mended, announce)
    return concluded(explanation, announce)


@dataclass(frozen=True)
class Explained:
    """A recording, and the terms that a search has found beyond its model."""

    space: Space
    chosen: Choice
    data: Measured
    selection: Selection

    @property
    def terms(self) -> list[Term]:
        """Terms that were found."""
        return self.selection.fit.terms


def explained(chosen: Choice, model: Machine, data: Measured, announce: Announce) -> Explained:
    """Search for what the model lacks, by a prediction."""
    predictor = chosen.predictor
    space = Space(model, predictor, data.period_s)
    proposer = proposer_for(predictor, model, data)
    if predictor.exact:
        return Explained(space, chosen, data, search(FreeRules(space, proposer), announce))
    rules = MeasuredRules(space, proposer)
    selection = search(rules, announce)
    if (settled := settled_beside(rules.space, selection.fit)) is not None:
        rules = MeasuredRules(Space(model, settled, data.period_s), proposer)
        selection = search(rules, announce)
    # Found given the others a mode is as little identified: once more without.
    if few := unidentifiable_modes(rules.space, selection.fit):
        proposer = proposer_for(predictor, model, data, {term.effect.id for term in few})
        rules = MeasuredRules(rules.space, proposer)
        selection = replace(search(rules, announce), of_too_few=few)
    return Explained(rules.space, chosen, data, selection)


@dataclass(frozen=True)
class _Verdict:
    """Verdict on the fitted terms: the terms with their uncertainty, and what nothing explains."""

    judged: _Judged
    floors: dict[int, float]  #: of the torques, by signal
    misfits: list[Misfit]  #: of the torques, in their floors
    conditions: list[Condition]
    unexplained: list[Misfit]
    unknown: bool
    certain: list[Term]

    @classmethod
    def of(cls, found: Explained) -> _Verdict:
        """Judge the residual of a search."""
        space, selection, predictor = found.space, found.selection, found.space.predictor
        rows, torques, names = predictor.rows, torques_of(predictor), predictor.names
        if predictor.exact:
            judged = _judged_by_noise(space, selection)
        else:  # by the spectrum of the residual, which is model error more than noise
            fitted = fit(space, weights(space, found.terms), found.terms)
            known = stated_uncertainty(space, selection.fit)
            judged = _Judged(fitted, selection.fit, known.covariance, known.quantiles(0.95), {})
        trained, final = judged.trained, judged.final
        # Fast motion that the model explains is no noise.
        floors = {k: floor(final.residual[k]) for k in torques}
        if predictor.exact:
            floors = {k: min(value, predictor.floor(k)) for k, value in floors.items()}
        conditions = predictor.conditions(space.packed(final.terms))
        after = misfits(*in_floors(predictor.names, final.residual, floors), rows, conditions)
        unexplained = [m for m in after if m.significant]
        if predictor.exact:
            others = [k for k in range(len(names)) if k not in torques]  # positions, speeds, tensions
            unexplained += beyond_noise(names, final.residual, rows, deviations_of(predictor), others)
            unknown = bool(unexplained) or exceeds_noise(final.residual, rows, floors)
        else:
            # Of a fit to all rows, and of one to the others on those held out: it has to hold where it was not made.
            left = ((final.residual, rows), (trained.residual, rows & space.split.test))
            unknown = any(
                rms(rest[k, at]) > LARGEST_REST * rms(predictor.measured[k, rows]) for rest, at in left for k in torques
            )
            if not unknown and (changes := lasting_change(space, selection)) is not None:
                unknown, unexplained = True, [changes, *unexplained]
        better, too_few = selection.better, selection.of_too_few
        for term in too_few:
            about_Hz = f"{term.values['frequency_Hz']:.2g} Hz"
            why = f"perhaps near {about_Hz}, which the few frequencies of this motion do not identify"
            unexplained.append(Misfit(names[torques[0]], f"a {term.effect.id}", why, 0.0, 0.0, "always"))
        unknown |= selection.exhausted or better is not None or bool(too_few)
        unexplained = [*([] if better is None else [better]), *unexplained]
        # Where a right model leaves noise alone what leaves more is right in nothing; elsewhere each effect was judged
        # with the rest as noise.
        certain = [] if unknown and predictor.exact else final.terms
        return cls(judged, floors, after, conditions, unexplained, unknown, certain)


def effects_of(found: Explained) -> list[NamedEffect]:
    """Effects that a search has found, with their intervals."""
    verdict = _Verdict.of(found)
    return _named(found.space.model, verdict.certain, verdict.judged, found.selection)


def concluded(found: Explained, announce: Announce = lambda text, share: None) -> Diagnosis:
    """The verdict on what a search has found; effects with their intervals, gaps, and where they were."""
    announce("judge the residual", 0.95)
    space, chosen, data, selection = found.space, found.chosen, found.data, found.selection
    predictor, before, test, of = space.predictor, space.before, space.split.test, _Verdict.of(found)
    trained, final, floors, conditions = of.judged.trained, of.judged.final, of.floors, of.conditions
    proposer = proposer_for(predictor, space.model, data)
    names, scaled = in_floors(predictor.names, before, floors)
    effects = _named(space.model, of.certain, of.judged, selection)
    gaps = [
        Gap(predictor.names[k], rms(before[k, test]), rms(trained.residual[k, test]), value, "N·m")
        for k, value in floors.items()
    ]
    where = located(names, scaled, predictor.rows, conditions, _ROWS_OF_WHERE)
    if not where:
        where = located(*in_floors(predictor.names, final.residual, floors), predictor.rows, conditions, _ROWS_OF_WHERE)
    depends = misfits(names, scaled, predictor.rows, conditions)
    floor_of = {predictor.names[k]: value for k, value in floors.items()}
    unidentifiable = [*selection.of_too_few, *selection.unidentifiable]
    laws = (
        law(name, rest, conditions, space.split.train, test)
        for name, rest in zip(names, final.residual[list(floors)], strict=True)
        if of.unexplained
    )
    return Diagnosis(
        verdict="unknown" if of.unknown else ("named" if final.terms else "complete"),
        effects=effects,
        gaps=gaps,
        where=[GapLocation(m.signal, m.when, f"{m.condition}: {m.detail}", round(share, 4)) for m, share in where],
        profiles=_profiles(depends, of.misfits, floor_of, max(gaps, key=_size).signal),
        unexplained=of.unexplained,
        unobservable=[
            *unobservable(selection),
            *_waves_too_fast(space, proposer, selection),
            *(
                Unobservable.of(t, least, f"{t.effect.shown_by}, for {Hz:g} Hz and above", frequency_Hz=Hz)
                for t, Hz, least in first_unseen(space, proposer, selection, _VISIBLE)
            ),
            *(Unobservable.of(t, None, f"{t.effect.shown_by}, to many speeds") for t in unidentifiable),
            *(
                Unobservable(effect.id, 1, None, effect.parameter(effect.strength[0]).unit, OTHER_HELD)
                for effect in unidentifiable_beside(predictor, space.model)  # while the other axis is coupled
            ),
        ],
        missing_channels=data.missing,
        model=extended(space.model, of.certain),
        names=predictor.names,
        t_s=data.t_s[:: predictor.every][: before.shape[1]],
        before=before,
        after=final.residual,
        held_out=test,
        simulations=space.simulations,
        emulation=predictor.emulation,
        predicted_on=chosen.basis,
        nuisance=_nuisance(space, chosen, final, effects),
        laws=[one for one in laws if one is not None],
        repairs=data.repairs,
    )


def _nuisance(space: Space, chosen: Choice, final: Fit, effects: list[NamedEffect]) -> list[NamedEffect]:
    """Deviations of the drives' loops from the model's, where certain; of a lone axis that shows them the presliding
    displacement of its friction, and coupling torques of another axis. A torque reported late looks like a loop lag."""
    model, predictor = space.model, space.predictor
    late = {e.axis for e in effects if e.effect == "torque_delay"}
    found = [
        NamedEffect(
            effect, loop.axis, {n: Value.of(*known) for n, known in values.items()}, {"likelihood_ratio": loop.gain}
        )
        for loop in chosen.loops
        for effect, values in nuisance_of(loop, model).items()
        if not (effect == "drive_lag" and loop.axis in late)
    ]
    if not isinstance(predictor, OnMeasuredMotion):
        return found
    if (sliding := predictor.presliding) is not None:
        unit = model.position_unit
        travel = Value.of(sliding.presliding_travel, sliding.ci95, unit)
        found.append(NamedEffect("presliding", 1, {f"way_{unit}": travel}, {}))
    if predictor.arm is not None:
        values = {name: Value.of(*known) for name, known in couplings(space, predictor, final).items()}
        found.append(NamedEffect("coupling", 1, values, {}))
    return found


@dataclass(frozen=True)
class _Judged:
    """The chosen terms fitted: to what fits may see, and to all rows; how sure each coordinate of the last is."""

    trained: Fit
    final: Fit
    covariance: Array  #: (J, J) of the last fit's coordinates
    quantiles: Array  #: (J,) half the 95 % interval in standard deviations
    moments: dict[tuple[int, str], tuple[float, float]]  #: intervals that do not follow from the covariance


def _judged_by_noise(space: Space, selection: Selection) -> _Judged:
    """Uncertainty by the noise that a right model leaves, which is white."""
    trained, white = selection.fit, selection.candidates.whitening
    samples = np.count_nonzero(space.split.train | space.split.test) * len(space.predictor.names)
    while True:
        train, test = sums(space, white, trained.residual)
        inflation = float(np.sqrt(max((train + test) / samples, 1.0)))
        final = _stated(space, white, trained.terms, inflation) if trained.terms else trained
        # The rows that the search held out may have brought a term to where its 95 % interval contains its neutral
        # value: without the least certain.
        sure = [max(final.wald(k), 0.0) ** 0.5 for k in range(len(final.terms))]
        if not sure or min(sure) > NORMAL_95 * inflation:
            break
        neutral = int(np.argmin(sure))
        trained = fit(space, white, [*trained.terms[:neutral], *trained.terms[neutral + 1 :]])
    moments = _moments(space, white, final, inflation)
    quantiles = np.full(len(final.covariance), NORMAL_95 * inflation)
    return _Judged(trained, final, final.covariance, quantiles, moments)


def _stated(space: Space, white: Whitening, terms: list[Term], inflation: float) -> Fit:
    """The terms fitted to all rows, with what else than noise makes the coordinates uncertain in the covariance, which
    is in units of a noise that is `inflation` times what was taken for it."""
    found = fit(space, white, terms, space.predictor.rows, enough=STATED)
    moved = moved_by_doubts(space, white, found) / inflation
    return replace(found, covariance=found.covariance + moved @ moved.T)


def _moments(
    space: Space, white: Whitening, final: Fit, inflation: float
) -> dict[tuple[int, str], tuple[float, float]]:
    """95 % intervals, by place among the terms and parameter, of times: from a profile, which may have many minima.

    What else than noise makes a time uncertain is in the fit's covariance alone: no interval is shorter than by that.
    """
    found, terms = {}, final.terms
    for place, (term, part) in enumerate(zip(terms, parts(terms), strict=True)):
        if not term.is_sudden:
            continue
        here, half_s = term.time_s, _PROFILE_S
        rise = (NORMAL_95 * inflation) ** 2
        times = around(here, half_s / 30.0, 0.5 * space.period_s)
        while True:
            times = np.union1d(times, around(here, half_s, half_s / 30.0))
            low, high = time_interval_s(space, white, terms, place, times, rise)
            if (times[0] < low and high < times[-1]) or half_s > space.duration_s:
                break
            half_s, times = 3.0 * half_s, np.array([here])
        k = part.start + term.free().index(term.onset)
        variance = float(final.covariance[k, k])
        # No recording has the time within a cycle at which it happened.
        least_s = max(space.period_s, NORMAL_95 * inflation * max(variance, 0.0) ** 0.5)
        found[place, term.onset] = (min(low, here - least_s), max(high, here + least_s))
    return found


def _named(model: Machine, terms: list[Term], judged: _Judged, selection: Selection) -> list[NamedEffect]:
    result = []
    for place, (term, part) in enumerate(zip(terms, parts(terms), strict=True)):
        gradient = term.gradient() * judged.quantiles[part]
        halves = np.sqrt(np.maximum(np.diag(gradient @ judged.covariance[part, part] @ gradient.T), 0.0))
        half_of = dict(zip(term.free(), map(float, halves), strict=True))
        values = {}
        for parameter in (term.effect.parameter(name) for name in term.own):
            value, half = term.values[parameter.name], half_of.get(parameter.name, 0.0)
            interval = judged.moments.get((place, parameter.name), (value - half, value + half))
            values[parameter.name] = Value.of(value, interval, parameter.unit)
        tied = [other for other in selection.tied.get(term.key, []) if other != term.place]
        names = [other.beside(term.place) for other in tied]
        advice, lookalike = None, term.effect.lookalike
        if tied and lookalike is not None and tied[0].effect == lookalike.name:
            advice = lookalike.distinguished_by
        elif tied:
            advice = term.effect.distinguished_from(machines.effect_of(model, tied[0].effect))
        evidence = selection.evidence.get(term.key, {})
        result.append(NamedEffect(term.effect.id, term.axis, values, evidence, names, advice, term.section))
    return _joined(terms, result)


def _joined(terms: list[Term], named: list[NamedEffect]) -> list[NamedEffect]:
    """The parts of one effect, each found as a term of its own, as one, with the evidence of the one found first."""
    joined: dict[tuple[Place, int], NamedEffect] = {}
    for term, effect in zip(terms, named, strict=True):
        place = (term.place, term.slot)
        first = joined.get(place)
        if first is None:
            joined[place] = effect
        else:
            tied = list(dict.fromkeys([*first.tied_with, *effect.tied_with]))
            joined[place] = replace(
                first,
                parameters=first.parameters | effect.parameters,
                tied_with=tied,
                told_apart_by=first.told_apart_by or effect.told_apart_by,
            )
    return list(joined.values())


def rounded(value: float) -> float:
    """Round to as many digits as any interval needs."""
    return float(f"{value:.{_DIGITS}g}")


def _profiles(before: list[Misfit], after: list[Misfit], floors: dict[str, float], signal: str) -> list[Profile]:
    """Profiles of one signal over the conditions on which it depended most before."""
    now = {m.condition: m for m in after if m.signal == signal and m.points}
    binned = [m for m in before if m.signal == signal and m.condition in now and m.condition != "time"]
    result = []
    for m in sorted(binned, key=lambda m: -m.excess)[:_PROFILES]:
        at, mean = np.array(m.points).T
        mean_after = np.array(now[m.condition].points)[:, 1]
        result.append(Profile(signal, m.condition, m.unit, at, mean * floors[signal], mean_after * floors[signal]))
    return result


def unobservable(selection: Selection, least_Nm: Callable[[Array], float] | None = None) -> list[Unobservable]:
    """Effects of which a change of the usual size would drown in the noise of these data, or make a torque (n,) of less
    than an rms that depends on it."""
    offered, result = selection.candidates, []
    seen = {term.place for term in selection.unidentifiable}
    for candidate, response in zip(offered.candidates, offered.responses, strict=True):
        if candidate.multiplicity > 1.0 or candidate.place in seen:
            continue
        seen.add(candidate.place)
        information = float(np.sum(offered.whitening.apply(response)[0] ** 2))
        smallest = _VISIBLE / np.sqrt(information) if information > 0.0 else None
        if smallest is not None and least_Nm is not None:
            smallest = max(smallest, least_Nm(response[0, 0]) / rms(response[0, 0]))
        if smallest is None or smallest > candidate.size:
            result.append(Unobservable.of(candidate, smallest, candidate.effect.shown_by))
    return result


def _waves_too_fast(space: Space, proposer: Proposer, selection: Selection) -> list[Unobservable]:
    """Effects with an order that these data could show at low orders alone: at their speed others are too fast."""
    result = []
    terms, white = selection.fit.terms, selection.candidates.whitening
    for place, waves in proposer.waves(_ORDERS).items():
        if any(term.place == place for term in terms) or not space.predictor.exact:
            continue
        for wave, response in zip(waves, space.strengths(terms, selection.fit.residual, waves), strict=True):
            information = float(np.sum(white.apply(response)[0][:, space.predictor.rows] ** 2))
            smallest = _VISIBLE / float(np.sqrt(information)) if information > 0.0 else float("inf")
            if smallest <= wave.size:
                continue
            order = float(wave.coordinates()[-1])
            advice = f"{wave.effect.shown_by}, for orders from {order:g} on slower than this"
            result.append(Unobservable.of(wave, smallest, advice, order=order))
            break
    return result
