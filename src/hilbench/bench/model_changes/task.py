"""Live diagnosis of a running bench: sends samples in chunks, and applies the findings to the twin's model.

In lockstep the answer to a chunk acts in the cycle in which the next one is complete, however long it took: no
cycle runs until then. In real time the bench never waits for one.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from operator import attrgetter
from struct import Struct
from typing import Final

from hilbench.bench.model_changes.process import LIVE_DIAGNOSIS, LiveProcess
from hilbench.bench.reports.change import Change, What
from hilbench.bench.reports.diagnosis_updates import (
    CHUNK_CYCLES,
    DiagnosisAnswer,
    DiagnosisUpdate,
    FoundEffect,
    GapRow,
    ModelChange,
    OutcomeKind,
    ProposalOutcome,
    Samples,
)
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import Exchange, Inputs
from hilbench.exchange.nodes import Nodes
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.real_time import ProcessSettings, beside_the_cycle
from hilbench.topology.quantities import MODEL_CHANGE, parse_effect_path
from hilbench.topology.sample import CycleSample
from hilbench.topology.signal_kinds import Signal
from hilbench.twin.virtual_io import MODEL_CHANGED, MODEL_CHANGING

_SOURCE: Final = "model"
#: Longest wall time without a cycle in lockstep: for an answer, for an SDO request of the twin, s.
_LONGEST_ANSWER_S, _LONGEST_REQUEST_S = 600.0, 5.0
#: Answers that may be outstanding in real time before chunks are left out, which the diagnosis sees as a gap.
_MOST_OUTSTANDING = 240


class ModelChanges(CyclicTask):
    """Follows the live diagnosis of one run. `apply`: models that it decides for are applied at once.

    `signals`: of a sample, in the order of a row; `model`: as configured; `last`: settings of the cycle's last
    process, None in lockstep.
    """

    def __init__(
        self,
        state: BenchState,
        nodes: Nodes,
        exchange: Exchange,
        process: LiveProcess,
        signals: Sequence[Signal],
        model: Machine,
        *,
        apply: bool,
        last: ProcessSettings | None,
    ) -> None:
        self.changes: list[ModelChange] = []
        self.gaps: list[GapRow] = []
        self._state = state
        self._nodes = nodes
        self._exchange = exchange
        self._process: LiveProcess | None = process
        names = [signal.name for signal in signals]
        self._row = attrgetter(*names)
        self._pack = Struct(f"={len(names) + 2}d").pack
        self._apply = apply
        self._lockstep = last is None
        self._rows: list[bytes] = []
        self._answers: deque[Future[DiagnosisAnswer]] = deque()
        self._pool = ThreadPoolExecutor(1, "twin-model", initializer=beside_the_cycle, initargs=(last,))
        self._request: Future[None] | None = None
        self._in_use = ""  # effects of the twin's model
        self._kind, self._configured = model.machine_kind, [entry.model_dump() for entry in model.effects]
        self._entries = self._configured  # what the machine is believed to have
        self._announced: ModelChange | None = None  # waits until the twin is free
        self._applying: ModelChange | None = None
        self._written = False  # the twin runs the changed model in addition to the one in use
        self._step: Future[float] | None = None  # of the change that the twin has made
        self._back_cycle = state.twin.back_cycle  # when the twin was taken back last

    @property
    def proposed(self) -> ModelChange | None:
        """The change that waits for an operator's word."""
        last = self.changes[-1] if self.changes else None
        waits = last is not None and last.decided_s is not None and last.applied_s is None and not last.refused
        return last if waits and last is not self._applying else None

    def owns(self, path: str) -> bool:
        """True if it is the quantity by which the operator announces a change."""
        return path == MODEL_CHANGE

    def value(self, path: str) -> float:
        """1 while the twin has, or is given, another model than the configured one."""
        return float(self._applying is not None or bool(self._in_use))

    def set(self, path: str, value: float) -> None:
        """Accept or refuse a proposed change as the operator says; nothing happens without a proposal."""
        change = self.proposed
        if change is None:
            self._state.reports.note(_SOURCE, "no change of the model is proposed")
        elif value:
            self._begin(change)
        else:
            self._refuse(change)

    def announced(self, path: str, value: float) -> None:
        """The machine has got an effect on purpose: it is in the twin's model from now on, and no anomaly."""
        of = parse_effect_path(path, self._kind)
        place = {"effect": of.effect, "axis": of.axis, "span": of.section}
        entries = [entry for entry in self._entries if any(entry[key] != each for key, each in place.items())]
        mine: dict[str, float] = next((entry["parameters"] for entry in self._entries if entry not in entries), {})
        parameters = {**find_effect(of.effect, self._kind).filled(mine), of.parameter: value}
        model = json.dumps([*entries, {**place, "parameters": parameters}], separators=(",", ":"))
        now_s = self._state.sample.t_s
        self._state.journal(Change(self._cycle, "model_announced", f"{path.split('.effects.', 1)[1]}", value))
        self._state.reports.note(_SOURCE, f"announced: {path} {value:g}: the twin's model follows")
        self._send_outcome("announced", model)
        self._announced = ModelChange(now_s, (), (), now_s, decided_s=now_s, model=model)
        self._entries = json.loads(model)

    def _refuse(self, change: ModelChange) -> None:
        change.refused = True
        self._journal("model_refused", change)
        self._state.reports.note(_SOURCE, f"refused by the operator: {_names(change)}")
        self._send_outcome("refused")

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Take an answer that is due, and continue a change of the model."""
        if self._request is not None and self._request.done():
            self._end_request(self._request)
        if self._state.twin.back_cycle != self._back_cycle:
            self._back_cycle = self._state.twin.back_cycle
            self._write_anew()
        if self._announced is not None and self._applying is None:
            change, self._announced = self._announced, None
            self._begin(change)
        if self._applying is not None and self._written:
            self._follow(self._applying, sample)
        if len(self._rows) >= CHUNK_CYCLES and self._process is not None:
            self._hand_over(self._process, sample)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Keep the sample for the next chunk."""
        if self._process is not None:
            elapsed_cycles = 0 if self._exchange.in_step else self._exchange.pacing.missed  # for the plant
            cycle, late = sample.cycle + elapsed_cycles, any(inputs.ages_cycles)
            self._rows.append(self._pack(*self._row(sample), cycle, late))

    # -- the diagnosis ---------------------------------------------------------------------------------------

    def _hand_over(self, process: LiveProcess, sample: CycleSample) -> None:
        if self._lockstep and self._answers:
            self._exchange.stand_still(self._answers[0], _LONGEST_ANSWER_S)
        while self._answers and self._answers[0].done():
            self._take(self._answers.popleft())
        if self._process is None or len(self._answers) > _MOST_OUTSTANDING:
            self._rows.clear()
            return
        self._answers.append(process.ask(Samples(sample.cycle, b"".join(self._rows))))
        self._rows.clear()

    def _take(self, answer: Future[DiagnosisAnswer]) -> None:
        try:
            watched = answer.result()
        except (EOFError, OSError):
            words = self._process.last_words() if self._process is not None else ""
            self._state.reports.note(LIVE_DIAGNOSIS, f"has ended, the run goes on without it: {words}")
            self._process = None
            self._answers.clear()
            return
        self.gaps += watched.gaps
        for news in watched.news:
            self._received(news)

    def _received(self, news: DiagnosisUpdate) -> None:
        self._state.reports.note(_SOURCE, news.text)
        if news.what == "seen":
            self._state.journal(Change(self._cycle, "gap_seen", value=self._time_s(news.begun_cycle)))
        elif news.what == "named":
            begun_s = self._time_s(news.begun_cycle)
            change = ModelChange(begun_s, news.effects, news.gone, self._state.sample.t_s, news.gap)
            self.changes.append(change)
            self._journal("effect_named", change, news.effects)
            self._journal("effect_gone", change, news.gone)
        elif news.what == "dismissed" and self.changes:
            change = self.changes.pop()
            self._journal("effect_dismissed", change)
        elif news.what == "decided" and self.changes:
            change = self.changes[-1]
            change.decided_s, change.gap, change.model = self._state.sample.t_s, news.gap, news.model
            if news.effects or news.gone:
                change.effects, change.gone = news.effects, news.gone
            if self._apply:
                self._begin(change)
            else:
                self._journal("model_proposed", change)
                self._state.reports.note(
                    _SOURCE, f"proposed: {_names(change)}; {MODEL_CHANGE} 1: go on with it, 0: do not"
                )

    # -- the twin --------------------------------------------------------------------------------------------

    def _begin(self, change: ModelChange) -> None:
        """Write the new model to the twin, to run in addition to its own."""
        assert change.model is not None, "as it was decided for"
        self._applying, self._written = change, False
        self._request = self._pool.submit(self._nodes.set_twin_effects, change.model)
        if self._lockstep:
            self._exchange.stand_still(self._request, _LONGEST_REQUEST_S)
            if self._request.done():
                self._end_request(self._request)

    def _write_anew(self) -> None:
        """Write the changed model again to a twin that was reset: it has the configured one."""
        if self._applying is not None:
            self._begin(self._applying)
        elif self._in_use:
            now_s = self._state.sample.t_s
            self._state.reports.note(_SOURCE, "the twin was reset: it gets the changed model once more")
            self._begin(ModelChange(now_s, (), (), now_s, decided_s=now_s, model=self._in_use))

    def _end_request(self, done: Future[None]) -> None:
        self._request = None
        try:
            done.result()
        except BenchFaultError as error:
            self._state.reports.note(_SOURCE, f"the twin does not take the model: {error}")
            self._applying = None
            self._send_outcome("refused")
            return
        self._written = True
        self._written_cycle = self._cycle

    def _follow(self, change: ModelChange, sample: CycleSample) -> None:
        """Wait until the twin has switched over; its answers may be some cycles old."""
        if self._step is not None:
            if self._step.done():
                self._end_change(change, self._step)
            return
        if sample.cycle <= self._written_cycle + 2 or sample.twin_status & MODEL_CHANGING:
            return
        if bool(sample.twin_status & MODEL_CHANGED) is not bool(change.model):
            return
        change.applied_s = sample.t_s
        self._step = self._pool.submit(self._nodes.twin_step_N)
        if self._lockstep:
            self._exchange.stand_still(self._step, _LONGEST_REQUEST_S)
            if self._step.done():
                self._end_change(change, self._step)

    def _end_change(self, change: ModelChange, step: Future[float]) -> None:
        self._applying, self._step, self._in_use = None, None, change.model or ""
        with suppress(BenchFaultError):  # it is not known then
            change.tension_step_N = step.result()
        self._entries = json.loads(change.model) if change.model else self._configured
        self._journal("model_applied", change)
        self._state.reports.note(_SOURCE, f"the twin goes on with {_names(change)}")
        self._send_outcome("applied", change.model or "")

    # -- words -----------------------------------------------------------------------------------------------

    @property
    def _cycle(self) -> int:
        return self._exchange.timing.cycles

    def _time_s(self, cycle: int) -> float:
        return self._state.experiment_time_s(cycle)

    def _send_outcome(self, what: OutcomeKind, model: str = "") -> None:
        if self._process is not None:
            self._process.send_outcome(ProposalOutcome(self._cycle, what, model))

    def _journal(self, what: What, change: ModelChange, effects: Sequence[FoundEffect] | None = None) -> None:
        for effect in [*change.effects, *change.gone] if effects is None else effects:
            strength = next(iter(effect.parameters.values())).value
            self._state.journal(Change(self._cycle, what, effect.place, strength))


def _names(change: ModelChange) -> str:
    there = ", ".join(effect.place for effect in change.effects)
    gone = ", ".join(f"no {effect.place}" for effect in change.gone)
    return ", ".join(filter(None, (there, gone))) or "the changed model"
