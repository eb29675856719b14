"""Comparison of two recordings of one machine: both explained together, and what differs in the later one.

What the earlier one lacks is found first, then what the later one does beside it; then both are explained together,
which gives the size of each change and its interval. Where a right model need not leave white noise a change has to be
larger than what nothing explains of either recording as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from hilbench.arrays import Array
from hilbench.diagnosis.diagnosis import (
    Diagnosis,
    Explained,
    NamedEffect,
    Value,
    concluded,
    effects_of,
    explained,
    unobservable,
)
from hilbench.diagnosis.fit import Fit, fit, inverse_of, weights
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.measured_rules import TIED
from hilbench.diagnosis.noise import NORMAL_95, rms
from hilbench.diagnosis.predictor import choice
from hilbench.diagnosis.residual_noise import uncertainty
from hilbench.diagnosis.search import Announce
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Key, Term, extended, parts
from hilbench.errors import UnusableInputError
from hilbench.plant.effect import Domain, ProbeOver
from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

Rows = NDArray[np.int64]

#: How many times as large torques, or speeds, of one machine may be in one recording as in the other.
_ONE_MACHINE: Final = 100.0
#: What belongs to one recording's clock: it is found anew in the other one, or not there.
_BY_THE_CLOCK: Final = (ProbeOver.TIME, ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION)
#: Where a right model need not leave white noise: standard errors, times the rest that nothing explains in the band in
#: which the change acts, and share of the torque of friction and offset from which a change counts. Friction of a real
#: drive is another by some per cent at every start: what is less is no news.
_ERRORS, _OVER_THE_REST, _DRIFT = 3.5, 2.0, 0.05
#: Share of a change's square that its band holds, how many times as wide it is taken, and at least how wide, Hz.
_BAND, _WIDER, _LEAST_BAND_HZ = 0.95, 3.0, 5.0
#: How many times as large the rest may be as it was before, until something has changed that nothing explains.
_MORE_REST: Final = 2.0
#: Corner in which an inertia is first estimated, Hz; speed, as a share of the highest, below which an axis is at rest.
_CORNER_HZ, _STANDSTILL = 10.0, 0.02


@dataclass(frozen=True)
class Run:
    """A recording and its place for messages."""

    recording: Recording
    place: str | Path
    emulation: AnyEmulation | None = None  #: how web or shaft was emulated, if the recording is a bench's


def compared(
    after: Run, before: Run, model: Machine | None, announce: Announce = lambda text, share: None
) -> Diagnosis:
    """Diagnose the change from `before` to `after`: effects with its size, beside `before` of each value.

    model: of the machine; None for a lone axis of which nothing is known: then its inertia comes from the recordings.
    Gaps and residuals are those of `after`, with the machine as it was before and as it is found now; so is the model.
    Raises UnusableInputError, one line, for recordings that can't be used or do not belong together.
    """
    announce("read both recordings", 0.02)
    if model is None:
        model = _lone_axis(after, before)
    now, then = (measured_from(run.recording, model, run.place) for run in (after, before))
    _check_together(now, then, after.place, before.place)
    found = _changes(model, now, then, (after.emulation, before.emulation), announce)
    repairs = [replace(repair, text=f"{before.place}: {repair.text}") for repair in then.repairs]
    return replace(found, repairs=[*now.repairs, *repairs])


def _check_together(now: Measured, then: Measured, place: str | Path, other: str | Path) -> None:
    """Check that two recordings can be of one machine. Raises UnusableInputError, one line."""
    for what, here, there in (("torque", now.tau_Nm, then.tau_Nm), ("position", now.x_m, then.x_m)):
        if set(here) != set(there):
            raise UnusableInputError(
                place, f"{what} of axes {sorted(here)} where {other} has {sorted(there)}, expected the same channels"
            )
    if now.emulated != then.emulated:
        made, other_made = ("with", "without") if now.emulated else ("without", "with")
        raise UnusableInputError(
            place, f"{made} a load motor and {other} {other_made} one, expected two recordings of one machine"
        )
    for axis in now.tau_Nm:
        torque = rms(now.tau_Nm[axis]), rms(then.tau_Nm[axis])
        speed = _top_speed(now, axis), _top_speed(then, axis)
        for what, unit, pair in (("torque", "N·m", torque), ("speed", "m/s or rad/s", speed)):
            if max(pair) > _ONE_MACHINE * min(pair):
                raise UnusableInputError(
                    place,
                    f"{what} of axis {axis} is {pair[0]:.3g} {unit} where it is {pair[1]:.3g} in {other}, expected two "
                    "recordings of one machine",
                )


def _top_speed(data: Measured, axis: int) -> float:
    """Between samples a tenth of a second apart; 1 where it is not known."""
    if axis not in data.x_m:
        return 1.0
    apart = max(1, round(0.1 / data.period_s))
    return float(np.max(np.abs(data.x_m[axis][apart:] - data.x_m[axis][:-apart]))) / (apart * data.period_s)


def _lone_axis(after: Run, before: Run) -> Machine:
    """A model of which only the inertia is known: the larger of what both recordings show (feed-forward hides some)."""
    inertia = 0.0
    for run in (after, before):
        if "x2_m" in run.recording:
            raise UnusableInputError("--model", "missing, expected the model file of a machine of several axes")
        inertia = max(inertia, _inertia(measured_from(run.recording, _axis_of(1.0, run.recording), run.place)))
    return _axis_of(inertia, after.recording)


def _axis_of(inertia: float, recording: Recording) -> Machine:
    """One shaft, in the units of its recording: torque over acceleration of x1_rad, or of x1_m."""
    if "x1_rad" in recording or "v1_rad_s" in recording:
        return ServoAxisParameters(shaft=ShaftParameters(inertia_kg_m2=inertia))
    return ModelParameters.model_validate(
        {"rollers": {"radius_m": 1.0, "inertia_kg_m2": inertia, "gear_ratio": 1.0}, "motors": {"inertia_kg_m2": 0.0}}
    )


def _inertia(data: Measured) -> float:
    """Torque per acceleration of axis 1, fitted with friction and offset, N·m/(unit of x1_m/s²); above 0."""
    nyquist = 0.5 / data.period_s
    sos = butter(2, min(_CORNER_HZ, 0.5 * nyquist) / nyquist, output="sos")
    x = sosfiltfilt(sos, data.x_m[1])
    v = np.gradient(x, data.period_s)
    columns = sosfiltfilt(sos, np.array([np.gradient(v, data.period_s), v, np.sign(v), np.ones(len(v))]), axis=1)
    torque = sosfiltfilt(sos, sosfiltfilt(sos, data.tau_Nm[1]))
    rows = (np.abs(v) > _STANDSTILL * float(np.max(np.abs(v)))) & data.usable(0.1)
    found, *_ = np.linalg.lstsq(columns[:, rows].T, torque[rows], rcond=None)
    least = 1e-3 * float(np.std(torque[rows])) / max(float(np.std(columns[0][rows])), 1e-300)
    return max(float(found[0]), least)


def _changes(
    model: Machine,
    now: Measured,
    then: Measured,
    emulations: tuple[AnyEmulation | None, AnyEmulation | None],
    announce: Announce,
) -> Diagnosis:
    """Find what differs in `now` from `then`; `emulations` of both, in that order."""

    def side(model: Machine, data: Measured, emulation: AnyEmulation | None, what: str, first: float) -> Explained:
        alone = replace(data, other_rad=None)
        return explained(
            choice(model, alone, emulation),
            model,
            alone,
            lambda text, share: announce(f"{what}: {text}", first + 0.3 * share),
        )

    before = side(model, then, emulations[1], "before", 0.0)
    was = extended(model, [term for term in before.terms if not _by_the_clock(term)])
    after = side(was, now, emulations[0], "after", 0.4)
    if not after.space.predictor.exact:
        return _changed_beyond_rest(before, _simplest(after))
    found = concluded(after, announce)
    if found.verdict == "unknown" and was != model:  # an effect that ended may hide a new one
        alone = side(model, now, emulations[0], "alone", 0.7)
        other = concluded(alone, announce)
        if other.verdict != "unknown":
            return _changed(other, _Joint.of(before, alone, kept=False), _lacked(before, before.terms))
    waves = [term for term in before.terms if _by_the_clock(term) and term.has_phase]
    return _changed(found, _Joint.of(before, after, kept=True), _lacked(before, waves))


def _by_the_clock(term: Term) -> bool:
    return term.effect.probe is not None and term.effect.probe.over in _BY_THE_CLOCK


def _lacked(before: Explained, terms: list[Term]) -> list[NamedEffect]:
    """The effects of some of the earlier recording's terms; what set in at a time of its own is no change that went."""
    places = {term.place for term in terms if term.has_phase or not _by_the_clock(term)}
    if not places:
        return []
    return [effect for effect in effects_of(before) if effect.place in places]


def _changed(found: Diagnosis, joint: _Joint, lacked: list[NamedEffect]) -> Diagnosis:
    """The diagnosis of the later recording, with changes for effects; `lacked`: those of the earlier one."""
    here = {effect.place for effect in found.effects}
    gone = [effect for effect in lacked if effect.place not in here]
    effects = [change for effect in [*found.effects, *gone] if (change := joint.change(effect)) is not None]
    verdict = found.verdict if found.verdict == "unknown" else ("named" if effects else "complete")
    return replace(found, effects=effects, verdict=verdict)


def _simplest(after: Explained) -> Explained:
    """Explanation with one effect in place of several where it is as good as they are: that is what happened."""
    space, selection = after.space, after.selection
    if len(after.terms) < 2:
        return after

    def left(found: Fit) -> float:
        return float(np.sum(found.residual[:, space.predictor.rows] ** 2))

    limit, alone = (1.0 + TIED) * left(selection.fit), list[Fit]()
    for term in [*after.terms, *selection.candidates.candidates]:
        white = weights(space, [term])
        alone.append(fit(space, white, [term], space.predictor.rows, limit * float(white.filters[0, 0]) ** 2))
    best = min(alone, key=left)
    return replace(after, selection=replace(selection, fit=best)) if left(best) < limit else after


def _changed_beyond_rest(before: Explained, after: Explained) -> Diagnosis:
    """Changes that are larger than what nothing explains of either recording, and than what friction is another by
    from start to start."""
    space, rows = after.space, after.space.predictor.rows
    heavy = [term for term in before.terms if term.effect.removable or term.effect.domain is Domain.INERTIA]
    friction = before.space.residual(heavy) - before.selection.fit.residual
    friction_Nm = rms(friction[:, before.space.predictor.rows])

    def least_Nm(made: Array) -> float:
        """Rms that a change with this torque (n,) of the later recording has to have."""
        corner_Hz = _corner_Hz(np.where(rows, made, 0.0), space.duration_s)
        return max(_OVER_THE_REST * max(_left_Nm(side, corner_Hz) for side in (after, before)), _DRIFT * friction_Nm)

    columns, kept, corner_Hz = space.point(after.terms, after.selection.fit.residual).derivatives[:, 0], [], 0.0
    for term, part in zip(after.terms, parts(after.terms), strict=True):
        made = term.moved @ columns[part][: term.linear]
        if rms(made[rows]) > least_Nm(made):
            kept.append(term)
            corner_Hz = max(corner_Hz, _corner_Hz(np.where(rows, made, 0.0), space.duration_s))
    found, places = concluded(after), {term.place for term in kept}
    left_before = max(_left_Nm(before), space.predictor.floor(0))
    unknown = found.verdict == "unknown" and _left_Nm(after) > _MORE_REST * left_before
    effects = [effect for effect in found.effects if effect.place in places]
    found = _changed(replace(found, effects=effects, verdict=""), _Joint.of(before, after, kept=True), [])
    here = {effect.place for effect in found.effects}
    trained = fit(space, weights(space, after.terms), after.terms).residual
    seen = [_slow(space, rest, corner_Hz or float("inf"))[space.split.test] for rest in (space.before, trained)]
    return replace(
        found,
        verdict="unknown" if unknown else found.verdict,
        gaps=[replace(found.gap, before=rms(seen[0]), after=rms(seen[1]))],
        where=found.where if found.effects else [],
        unexplained=found.unexplained if unknown else [],
        laws=found.laws if unknown else [],
        unobservable=unobservable(after.selection, least_Nm),
        model=extended(space.model, [term for term in kept if term.place in here]),
    )


def _corner_Hz(made: Array, duration_s: float) -> float:
    """End of the band in which a torque (n,) acts."""
    power = np.cumsum(np.abs(np.fft.rfft(made)) ** 2)
    return max(_WIDER * float(np.searchsorted(power, _BAND * power[-1])) / duration_s, _LEAST_BAND_HZ)


def _left_Nm(side: Explained, corner_Hz: float = float("inf")) -> float:
    """Rms of what is left of a recording below a frequency."""
    return rms(_slow(side.space, side.selection.fit.residual, corner_Hz)[side.space.predictor.rows])


def _slow(space: Space, residual: Array, corner_Hz: float) -> Array:
    """(n,): what a residual (1, n) has below a frequency, in the rows that count."""
    spectrum = np.fft.rfft(np.where(space.predictor.rows, residual[0], 0.0))
    spectrum[np.arange(len(spectrum)) > corner_Hz * space.duration_s] = 0.0
    return np.asarray(np.fft.irfft(spectrum, residual.shape[1]))


@dataclass(frozen=True)
class _Joint:
    """Coordinates of the terms of both recordings, explained together, with their covariance."""

    before: dict[Key, tuple[Term, Rows]]  #: terms, with the places of their coordinates
    after: dict[Key, tuple[Term, Rows]]
    step: Array
    covariance: Array
    quantiles: Array  #: (J,) half the 95 % interval in standard deviations
    errors: float  #: standard errors from which a change is one

    @classmethod
    def of(cls, before: Explained, after: Explained, *, kept: bool) -> _Joint:
        """One step of Gauss and Newton from where each was fitted alone.

        kept: whether the model of the later one has what was found in the earlier one; then a term that the later one
        has no value of its own for is the same in both.
        """
        anew = {term.key for term in after.terms}
        shared = [t for t in before.terms if kept and t.key not in anew and not _by_the_clock(t)]
        own = [term for term in before.terms if term not in shared]
        everything = [*shared, *own, *after.terms]
        places = [(t, np.arange(part.start, part.stop)) for t, part in zip(everything, parts(everything), strict=True)]
        first, count = len(shared) + len(own), sum(len(at) for _, at in places)
        sides = [
            _linearized(side, chosen, count)
            for side, chosen in ((before, places[:first]), (after, [*places[: len(shared)], *places[first:]]))
        ]
        flat = [(columns.reshape(count, -1), rest.ravel()) for columns, rest in sides]
        grams = [columns @ columns.T for columns, _ in flat]
        gram = grams[0] + grams[1]
        inverse = inverse_of(gram)
        step = inverse @ sum(columns @ rest for columns, rest in flat)
        if after.space.predictor.exact:
            square, samples = (sum(each) for each in zip(*((rest @ rest, len(rest)) for _, rest in flat), strict=True))
            covariance, quantiles = inverse * max(float(square) / max(samples, 1), 1.0), np.full(count, NORMAL_95)
        else:
            known = [
                uncertainty(columns, rest, other) for (columns, rest), other in zip(sides, grams[::-1], strict=True)
            ]
            covariance = known[0].covariance + known[1].covariance - inverse
            quantiles = np.maximum(*(each.quantiles(0.95) for each in known))
        return cls(
            {term.key: (term, at) for term, at in places[:first]},
            {term.key: (term, at) for term, at in places[first:]},
            step,
            covariance,
            quantiles,
            NORMAL_95 if after.space.predictor.exact else _ERRORS,
        )

    def change(self, effect: NamedEffect) -> NamedEffect | None:
        """The effect with the size of the change of its strength; None where that may be none."""
        key = next(key for key in [*self.after, *self.before] if key[0] == effect.place)
        term, _ = self.after.get(key) or self.before[key]
        strengths, difference, quantile = [], np.zeros((term.linear, len(self.step))), 0.0
        for side, sign in ((self.after, 1.0), (self.before, -1.0)):
            if key not in side:
                strengths.append(term.neutral().coordinates()[: term.linear])
                continue
            found, at = side[key][0], side[key][1][: term.linear]
            strengths.append(np.asarray(found.coordinates()[: term.linear] + self.step[at]))
            difference[np.arange(term.linear), at] = sign
            quantile = max(quantile, float(np.max(self.quantiles[at])))
        here, was = strengths
        covariance = difference @ self.covariance @ difference.T
        if not term.has_phase:
            change, error = float(here[0] - was[0]), float(np.sqrt(max(covariance[0, 0], 0.0)))
        elif _by_the_clock(term):  # its phase is that of another clock: amplitudes are compared
            change = float(np.linalg.norm(here) - np.linalg.norm(was))
            error = float(np.sqrt(max(float(np.max(np.diag(covariance))), 0.0)))
        else:
            change = float(np.linalg.norm(here - was))
            direction = (here - was) / max(change, 1e-300)
            error = float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
        half = quantile * error
        if abs(change) <= max(half, self.errors * error):
            return None
        strength = term.effect.strength[0]
        known, unit = float(np.linalg.norm(was) if term.has_phase else was[0]), term.effect.parameter(strength).unit
        size = Value.of(change, (change - half, change + half), unit, known)
        return replace(effect, parameters={**effect.parameters, strength: size})


def _linearized(side: Explained, chosen: list[tuple[Term, Rows]], count: int) -> tuple[Array, Array]:
    """Whitened derivatives (count, signals, rows) by the coordinates of terms at these places, zero by others, and the
    residual (signals, rows), on rows that count."""
    space, terms = side.space, [term for term, _ in chosen]
    white = side.selection.candidates.whitening if space.predictor.exact else weights(space, terms)
    rows, point = space.predictor.rows, space.point(terms)
    columns = np.zeros((count, len(point.residual), int(np.count_nonzero(rows))))
    columns[np.concatenate([np.empty(0, np.int64), *(at for _, at in chosen)])] = white.apply(point.derivatives)[
        ..., rows
    ]
    return columns, white.apply(point.residual)[:, rows]
