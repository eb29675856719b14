"""One run beside which is diagnosed: samples in, news out.

    watching ── parts for a while ──▶ naming ── named ──▶ trial ── decided ──▶ waiting ── applied ──▶ watching
        ▲                              │ nothing the structure has to do with   │ not better
        └──────────────────────────────┴────────────────────────────────────────┘

What is decided depends on the samples alone, not on how long anything took.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.bench.reports.diagnosis_updates import (
    CHUNK_CYCLES,
    DiagnosisAnswer,
    DiagnosisUpdate,
    FoundEffect,
    FoundGap,
    FoundValue,
    GapRow,
    ProposalOutcome,
    Samples,
)
from hilbench.diagnosis import machines
from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, diagnosed
from hilbench.diagnosis.measured import SHORTEST_S
from hilbench.diagnosis.noise import floor, rms
from hilbench.diagnosis.predictor import deviations_of, torques_of
from hilbench.diagnosis.residual_analysis import exceeds_noise, in_floors, misfits
from hilbench.errors import UnusableInputError
from hilbench.live.machine import SHORT, LiveMachine, Segment
from hilbench.live.watch import ROW, Piece, Watch
from hilbench.live.window import Window
from hilbench.plant.effect import Effect, ProbeOver, Section
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.topology.blocks import LiveDiagnosisConfig
from hilbench.twin.model_switch import with_effects

AnyLive = LiveMachine[Any]

#: Effects that begin at a time, or swing with it, by a clock that a window and a twin do not share.
_BY_THE_CLOCK = (ProbeOver.TIME, ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION, ProbeOver.PASSAGE)


def _found_effect(named: NamedEffect, model: Machine) -> FoundEffect:
    """Effect that a model lacks, as reported to the bench."""
    values = {name: FoundValue(value.value, value.ci95, value.unit) for name, value in named.parameters.items()}
    section = _section(find_effect(named.effect, model.machine_kind), named.section, model)
    return FoundEffect(named.effect, named.axis, section, values, tuple(named.tied_with))


def _of_entry(entry: EffectEntry, model: Machine) -> FoundEffect:
    """An effect of a model, whose values are what they are."""
    effect = find_effect(entry.effect, model.machine_kind)
    values = {
        name: FoundValue(value, (value, value), effect.parameter(name).unit) for name, value in entry.parameters.items()
    }
    return FoundEffect(entry.effect, entry.axis, _section(effect, entry.section, model), values)


def _section(effect: Effect, section: Section | None, model: Machine) -> int | None:
    """The number of the section that an effect is in: of the only one 1, None for one that is in all of them."""
    if not effect.per_section:
        return None
    return 1 if model.span_count == 1 else section if isinstance(section, int) else None


#: From the first piece that parts until the transient of what happened is over, s.
_SETTLED_S: Final = 1.0
#: How much less a sum of squares has to be for a model to be better, beside its price: far beyond chance.
_DECISIVE: Final = 40.0
#: Pieces in a row that part, behind others that did not, from which on it is they that are looked into.
_LASTING: Final = 2 * ROW
#: Times the configured window after which nothing more is hoped for from more of it, and lengths of a trial.
_LONGEST, _TRIALS = 4, 3
#: What is estimated, as the model goes by it, is the twin's, as it was between these times before now, s.
_FROM_S, _TO_S = 6.0, 2.0
#: How far off the estimate may be from what it was, as a share, while nothing parts.
_DRIFT: Final = 0.01
#: How well it is known then, as a share, and in which steps its best value is looked for.
_SURE, _STEP = 0.005, 0.02


@dataclass(frozen=True)
class _Case:
    """State of a case: since when model and measurement differ, and what has been found of it."""

    begun: int
    lacking: int  #: shortest data that could say more, in cycles
    candidate: Machine | None = None
    effects: tuple[FoundEffect, ...] = ()
    gone: tuple[FoundEffect, ...] = ()
    trial: int = 0  #: cycle from which data are new


class Session:
    """Live diagnosis of one run of a machine; `names`: of the signals of a row."""

    def __init__(self, names: Sequence[str], machine: AnyLive, config: LiveDiagnosisConfig, cycle_s: float) -> None:
        self._machine = machine
        self._configured: Machine = machine.configured
        self._in_use: Machine = machine.configured
        self._config = config
        self._cycle_s = cycle_s
        self._window = Window(names, round(config.memory_s / cycle_s), cycle_s)
        self._watch = Watch(machine, machine.configured)
        self._original = Watch(machine, machine.configured)
        self._estimate = machine.estimate_of(machine.configured)
        self._state: Literal["watching", "naming", "trial", "waiting"] = "watching"
        self._case: _Case | None = None
        self._pieces: deque[Piece] = deque(maxlen=round(config.memory_s / (CHUNK_CYCLES * cycle_s)))
        self._pieces_calm = 0  # while waiting
        self._seen_until = 0  # cycle of the plant
        self._news: list[DiagnosisUpdate] = []

    # -- what comes from the bench ---------------------------------------------------------------------------

    def samples(self, samples: Samples) -> DiagnosisAnswer:
        """The next chunk."""
        self._window.add(samples.cycle, samples.rows)
        piece, original = self._watched()
        self._news = []
        if self._state == "watching":
            self._look()
        case = self._case
        if self._state == "naming" and case is not None:
            self._name(case)
        elif self._state == "trial" and case is not None:
            self._try(case)
        elif self._state == "waiting":
            self._pieces_calm = 0 if self._watch.in_a_row else self._pieces_calm + 1
            if self._pieces_calm >= ROW:
                self._begin_anew()
        return DiagnosisAnswer(samples.cycle, tuple(self._news), self._gap_rows(samples.cycle, piece, original))

    def _watched(self) -> tuple[Piece | None, Piece | None]:
        """New samples since the last call, in whole means, as both watches see them."""
        window, watches = self._window, (self._watch, self._original)
        if window.first > self._seen_until or not self._seen_until:
            self._seen_until = window.first
            for watch in watches:
                watch.restart()
        end = self._seen_until + (window.end - self._seen_until) // SHORT * SHORT
        if end - self._seen_until < SHORT:
            return None, None
        channels, known = self._channels(self._seen_until, end)
        self._seen_until = end
        piece, original = (watch.update(end - 1, channels, known) for watch in watches)
        if piece is not None:
            self._pieces.append(piece)
        return piece, original

    def _channels(self, first: int, end: int) -> tuple[dict[str, Array], Rows]:
        """Channels of a gap in the cycles until `end` that are kept, in whole means; and which rows are known."""
        rows, known = self._window.rows(first, end), self._window.known(first, end)
        counted = len(rows) // SHORT * SHORT
        at = slice(len(rows) - counted, None)
        return {name: self._window.column(rows, name)[at] for name in self._machine.needed}, known[at]

    def outcome(self, outcome: ProposalOutcome) -> None:
        """Take the outcome or the announcement of a model change."""
        if outcome.what == "refused":
            self._state = "waiting"
            return
        self._use(with_effects(self._configured, outcome.model))

    def _gap_rows(self, cycle: int, piece: Piece | None, original: Piece | None) -> tuple[GapRow, ...]:
        """Gaps of each axis by the original and the present model."""
        nothing = np.full(len(self._machine.speeds), np.nan)
        sizes = (nothing if each is None else each.size for each in (original, piece))
        pairs = zip(*sizes, strict=True)
        return tuple(GapRow(cycle, f"tau{k}_Nm", float(was), float(now)) for k, (was, now) in enumerate(pairs, 1))

    # -- watching --------------------------------------------------------------------------------------------

    def _use(self, model: Machine) -> None:
        """Watch with another model from now on."""
        self._in_use = model
        anew = Watch(self._machine, model)
        anew.learned_from(self._watch)
        anew.use_estimate(self._estimate)
        anew.follow(*self._channels(self._machine.followed_from(self._window, self._seen_until), self._seen_until))
        self._watch = anew
        self._state, self._case = "watching", None

    def _look(self) -> None:
        if self._watch.in_a_row < ROW:
            self._follow_estimate()
            return
        begun = self._watch.begun_cycle
        self._state, self._case = "naming", _Case(begun, self._cycles(self._config.window_s))
        self._send("seen", begun, "model and measurement part")

    def _follow_estimate(self) -> None:
        """Keep to what the twin finds, while nothing is wrong."""
        end = self._window.end - self._cycles(_TO_S)
        rows = self._window.rows(self._window.end - self._cycles(_FROM_S), end)
        if self._watch.in_a_row or len(rows) < self._cycles(_FROM_S - _TO_S):
            return
        found = np.median(self._window.columns(rows, self._machine.estimated), axis=0)
        # More at once, and nothing parts: the twin has mistaken something else for it, and will find out.
        self._use_estimate(np.where(np.abs(found / self._estimate - 1.0) < _DRIFT, found, self._estimate))

    def _use_estimate(self, estimate: Array) -> None:
        self._estimate = estimate
        self._watch.use_estimate(estimate)
        self._original.use_estimate(estimate)

    # -- naming ----------------------------------------------------------------------------------------------

    def _name(self, case: _Case) -> None:
        if self._is_another(case):
            case = self._case = _Case(self._watch.begun_cycle, self._cycles(self._config.window_s))
            self._send("seen", case.begun, "model and measurement part again")
        earliest, end = case.begun + self._cycles(_SETTLED_S), self._window.end
        first = self._machine.quiet_cycle(self._window, earliest, end)
        if first is None or end - first < case.lacking:
            return
        if sum(piece.parts for piece in self._pieces if piece.cycle >= first) < ROW:
            self._send("ended", case.begun, "it has passed by itself: the model stays as it is")
            self._state, self._case = "watching", None
            return
        try:
            estimate = self._machine.estimate_in(self._window, self._in_use, self._estimate, first, end)
            before = self._machine.with_estimate(self._in_use, estimate)
            simpler = self._explained_without(before, first, end, case.begun)
            if simpler is not None:
                without = [entry for entry in self._in_use.effects if entry not in simpler.effects]
                gone = tuple(_of_entry(entry, self._configured) for entry in without)
                self._found(replace(case, candidate=simpler, gone=gone, trial=end))
                return
            data = self._machine.data_of(self._window, before, first, end, case.begun)
            # It began before them. What may have set in since is looked for only where nothing else is left: at each of
            # many times that takes as long as all the rest.
            settled = case.lacking < self._longest
            found = diagnosed(replace(data, settled=settled), before, emulation=self._machine.emulation)
        except UnusableInputError as error:
            self._send("ended", case.begun, f"can't be diagnosed: {error}")
            self._state = "waiting"
            return
        self._judge(found, case, end)

    def _is_another(self, case: _Case) -> bool:
        """True if the cause of a case had passed before the present gap began."""
        begun = self._watch.begun_cycle
        if begun <= case.begun or self._watch.in_a_row < _LASTING:
            return False
        between = [piece.parts for piece in self._pieces if case.begun <= piece.cycle < begun]
        return 2 * sum(between) < len(between)

    def _explained_without(self, before: Machine, first: int, end: int, begun: int) -> Machine | None:
        """The model in use without what has been added to it, where that explains these data as well as any."""
        added = [entry for entry in self._in_use.effects if entry not in self._configured.effects]
        if not added:
            return None
        options = [self._configured]
        if len(added) > 1:
            for entry in added:
                kept = [other for other in self._in_use.effects if other != entry]
                options.append(machines.with_effects(self._configured, kept))
        segment = Segment.of(self._machine, self._window, before, first, end, begun)
        for option in options:
            if self._is_noise(segment, option):
                return option
        return None

    def _is_noise(self, segment: Segment, model: Machine) -> bool:
        """True if a model leaves nothing but noise of the torques."""
        predictor, (residual, _) = segment.predictor, self._fitted(segment, model)
        floors = {k: predictor.floor(k) for k in torques_of(predictor)}
        if exceeds_noise(residual, predictor.rows, floors):
            return False
        conditions = predictor.conditions(machines.packed(model))
        found = misfits(*in_floors(predictor.names, residual, floors), predictor.rows, conditions)
        return not any(each.significant for each in found)

    def _judge(self, found: Diagnosis, case: _Case, end: int) -> None:
        structure = [e for e in found.effects if not self._machine.is_of_estimate(e.effect)]
        tied = [name.split(" ")[0] for effect in found.effects for name in effect.tied_with]
        undecided = found.verdict == "unknown" or any(map(self._machine.is_of_estimate, tied))
        if found.verdict == "complete" or (found.effects and not structure and found.verdict == "named"):
            why = "nothing is missing" if found.verdict == "complete" else "it is the twin's estimate that has changed"
            self._send("ended", case.begun, f"{why}: the model stays as it is")
            self._estimate = self._machine.estimate_at(found.model, float(found.t_s[-1]))
            self._begin_anew()
            return
        if undecided:
            if case.lacking >= self._longest:
                self._send("unknown", case.begun, "no effect explains for certain what the model lacks")
                self._state = "waiting"
            else:
                self._case = replace(case, lacking=2 * case.lacking)
            return
        candidate = self._machine.without_estimate(found.model)
        effects = tuple(_found_effect(each, self._configured) for each in structure)
        self._found(replace(case, candidate=candidate, effects=effects, trial=end))

    def _found(self, case: _Case) -> None:
        what = [*map(_text, case.effects), *(f"no {_place(effect)} any more" for effect in case.gone)]
        self._case, self._state = case, "trial"
        self._send("named", case.begun, f"named: {', '.join(what)}; tried on new data beside the model in use")

    # -- trial -----------------------------------------------------------------------------------------------

    def _try(self, case: _Case) -> None:
        """Both models on data that neither has seen."""
        assert case.candidate is not None
        end = self._window.end
        first = self._machine.quiet_cycle(self._window, case.trial, end)
        length = self._cycles(self._config.trial_s) + 1
        if first is None or end - first < length:
            return
        new = self._machine.with_estimate(case.candidate, self._estimate)
        try:
            segment = Segment.of(self._machine, self._window, new, first, end, case.begun)
        except UnusableInputError as error:
            self._send("ended", case.begun, f"can't be tried: {error}")
            self._begin_anew()
            return
        before = segment.residual(self._machine.with_estimate(self._in_use, self._estimate))
        (_, old_cost), (after, new_cost) = (self._fitted(segment, model) for model in (self._in_use, case.candidate))
        gain = old_cost - new_cost
        # A change that many samples make certain may still be too small to matter: of an effect that the model
        # has, a little more or less, put down to another one.
        if gain > _DECISIVE and segment.shows_in_torque(before, after):
            self._decide(case, self._gap(case.candidate, first, end, segment.predictor.rows))
        elif gain < 0.0 or end - first >= _TRIALS * length:
            self._send("dismissed", case.begun, "on new data the model in use is as good as the changed one: it stays")
            self._begin_anew()

    def _fitted(self, segment: Segment, model: Machine) -> tuple[Array, float]:
        """Residual (signals, n) and cost of a model on a segment, with the estimate that suits it best there: in so far
        as it is not far from what was known before model and measurement parted."""
        count = len(self._estimate)
        changes = np.vstack([np.zeros(count), _STEP * np.eye(count)])
        rows, scale = segment.predictor.rows, deviations_of(segment.predictor)[:, None]
        here, *there = ((segment.residual(self._changed(model, change)) / scale)[:, rows].ravel() for change in changes)
        slopes = (np.array(there) - here) / _STEP
        best = -np.linalg.solve(slopes @ slopes.T + np.eye(count) / _SURE**2, slopes @ here)
        best = np.clip(best, -0.5, 1.0)
        residual = segment.residual(self._changed(model, best))
        return residual, segment.misfit(residual) + float(np.sum((best / _SURE) ** 2))

    def _changed(self, model: Machine, shares: Array) -> Machine:
        """A model whose estimate is more by these shares (M,) of what it is."""
        changed: Machine = self._machine.with_estimate(model, (1.0 + shares) * self._estimate)
        return changed

    def _gap(self, candidate: Machine, first: int, end: int, rows: Rows) -> FoundGap:
        """Gap of the models in use and changed, from cycle `first` to before `end`, on the `rows` (n,) of the
        decision. Other forces on the axes, after rows that come late, are neither model's."""
        channels, known = self._channels(self._machine.followed_from(self._window, first), end)
        known[-len(rows) :] &= rows[-len(known) :]
        seen = []
        for model in (self._in_use, candidate):
            gap = self._machine.gap(model)
            gap.use_estimate(self._estimate)
            seen.append(gap.follow(channels, known)[-((end - first) // SHORT) :])
        before, after = (each[np.all(np.isfinite(each), axis=1)] for each in seen)
        floors = np.array([floor(column) for column in after.T])
        if (learned := self._watch.noise_Nm) is not None:
            # Of few means by chance less than the noise of the torques alone makes of them.
            floors = np.maximum(
                learned, [floor(channels[f"tau{k + 1}_Nm"]) / np.sqrt(SHORT) for k in range(len(learned))]
            )
        worst = int(np.argmax(np.sqrt(np.mean(before**2, axis=0)) / floors))
        size_before, size_after = (rms(each[:, worst]) for each in (before, after))
        return FoundGap(f"tau{worst + 1}_Nm", "N·m", size_before, size_after, float(floors[worst]))

    def _decide(self, case: _Case, gap: FoundGap) -> None:
        assert case.candidate is not None
        self._state = "waiting"
        probes = (find_effect(each.effect, self._configured.machine_kind).probe for each in case.effects)
        if any(probe is not None and probe.over in _BY_THE_CLOCK for probe in probes):
            why = "it goes by a clock that the twin does not have"
            self._send("ended", case.begun, f"{why}: the model stays as it is")
            return
        entries = case.candidate.effects
        text = json.dumps([entry.model_dump() for entry in entries], separators=(",", ":"))
        if entries == self._configured.effects:
            text = ""  # as the twin reads it, those that it was configured with
        smaller = f"{gap.signal} {gap.before:.3g} → {gap.after:.3g} {gap.unit} on new data, noise {gap.noise_floor:.3g}"
        news = DiagnosisUpdate(
            "decided", self._window.sync(case.begun), f"decided: {smaller}", case.effects, case.gone, text, gap
        )
        self._news.append(news)

    def _begin_anew(self) -> None:
        self._use(self._in_use)
        self._original.use_estimate(self._estimate)

    # -- words -----------------------------------------------------------------------------------------------

    def _send(self, what: Literal["seen", "named", "dismissed", "ended", "unknown"], begun: int, text: str) -> None:
        case = self._case
        effects, gone = (case.effects, case.gone) if case is not None and what == "named" else ((), ())
        self._news.append(DiagnosisUpdate(what, self._window.sync(begun), text, effects, gone))

    @property
    def _longest(self) -> int:
        """Cycles beyond which more of them are not hoped to say more."""
        return _LONGEST * self._cycles(self._config.window_s)

    def _cycles(self, duration_s: float) -> int:
        return round(duration_s / self._cycle_s)


def _place(effect: FoundEffect) -> str:
    return f"{effect.effect} of {effect.part}" if effect.part else effect.effect


def _text(effect: FoundEffect) -> str:
    sizes = (f"{name} {value.value:.4g}" for name, value in effect.parameters.items())
    return f"{_place(effect)} ({', '.join(sizes)})"


#: Noise of the torques, N·m.
_NOISE_Nm: Final = 0.05
#: What the machine did before the segment that is diagnosed, and that, s.
_BEFORE_S, _STRETCH_S = 2.0, SHORTEST_S + 0.5


def warm_up(names: Sequence[str], machine: AnyLive, config: LiveDiagnosisConfig, cycle_s: float) -> None:
    """Compile and load a `Session` with these arguments; nothing else is kept."""
    first, count = round(_BEFORE_S / cycle_s), round((_BEFORE_S + _STRETCH_S) / cycle_s)
    noise, t_s = np.random.default_rng(0), cycle_s * np.arange(count)
    speed, steady = machine.steady(CHUNK_CYCLES * cycle_s)
    steady |= dict(zip(machine.estimated, machine.estimate_of(machine.configured).tolist(), strict=True))
    channels = {name: np.full(count, steady.get(name, 0.0)) for name in names}
    channels["t_s"] += t_s
    for name, values in channels.items():
        if name.startswith("x"):
            values += speed * t_s
        elif name.startswith("v"):
            values += speed
        elif name.startswith("tau"):
            values += _NOISE_Nm * noise.standard_normal(count)
    rows = np.column_stack(list(channels.values()))
    session = Session(names, machine, config, cycle_s)
    for end in range(CHUNK_CYCLES, (ROW + 1) * CHUNK_CYCLES, CHUNK_CYCLES):
        session.samples(Samples.of(end - 1, rows[end - CHUNK_CYCLES : end]))
    window = Window(names, count, cycle_s)
    window.add(count - 1, Samples.of(count - 1, rows).rows)
    with suppress(UnusableInputError):  # of made-up data nothing has to come
        segment = Segment.of(machine, window, machine.configured, first, count, 0)
        segment.residual(machine.configured)
