"""The bench of a config file, as a script, a notebook or a test uses it."""

from __future__ import annotations

import atexit
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Self

from hilbench.apps.history.entries import remember
from hilbench.apps.history.web_line_priors import with_commissioned
from hilbench.bench import bench
from hilbench.bench.bench import InterruptedByOperatorError
from hilbench.bench.check import check_bench
from hilbench.bench.lifecycle.participants import Participants, check_in_process
from hilbench.bench.lifecycle.startup import held_bus
from hilbench.bench.reports.change import Change
from hilbench.errors import UnusableInputError
from hilbench.processes import finishing
from hilbench.results.commissioned import commissioned_text
from hilbench.results.recording import Recording
from hilbench.results.recording_builder import Recorder
from hilbench.results.run import WRITING, RunRecord
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load_with_overrides
from hilbench.runs.criteria import CriterionResult, failed_or_passed
from hilbench.runs.events import EventLog
from hilbench.runs.metrics import Judgement, Metrics, judge
from hilbench.topology import quantities


@dataclass(frozen=True)
class StepResponse:
    """Response to a step change: the whole recording, time of the step (s of experiment time), and metrics.

    Metrics are those of `hilbench.runs.metrics.all_metrics` that a recording decides, of this step alone; `not_judged`
    gives the reasons for missing ones, and so does the error when one is read.
    """

    recording: Recording
    step_time_s: float
    metrics: Metrics
    not_judged: dict[str, str] = field(default_factory=dict)


def _on_standard_error(text: str) -> None:
    print(f"hilbench: {text}", file=sys.stderr)


class Bench(bench.Bench):
    """A bench from its config file that keeps what it measured.

    Use it as a context manager; what it can do is in `hilbench.bench.bench.Bench`::

        with Bench("bench_configs/web_section_step.yaml", changes=["tension_control.set_point_N=90"]) as bench:
            bench.ramp("line_speed_m_s", 3.0, duration_s=4.0)
            bench.run(2.0)
        bench.recording.to_pandas()[["F_true_N", "F_sim_N"]].plot()

    `bus`, `pace`, `seed` and `changes` (texts ``KEY=VALUE``) are what ``hilbench run`` takes. Raises UnusableInputError
    for a config that cannot be used, before anything is started; entering raises it for a bus that has another master
    (`force`: unless it was only received). Steps and criteria of the file are left alone.

    What an operator must know (`notices`) is printed on standard error, or to `announce`.

    With `out`, entering makes a run folder there (`folder`), as ``hilbench run`` does, with config, trace and journal;
    leaving adds recording and result. In the result what ended the bench is a fault, but for a failed assertion, and
    what was added to `verdicts`: those are criteria. `name`: of the folder, instead of the config's.
    """

    def __init__(
        self,
        config: str | PathLike[str],
        *,
        bus: str | None = None,
        pace: str | None = None,
        seed: int | None = None,
        changes: Sequence[str] = (),
        participants: Participants = Participants.STARTED,
        announce: Callable[[str], None] | None = None,
        force: bool = False,
        out: str | PathLike[str] | None = None,
        name: str | None = None,
    ) -> None:
        loaded = load_with_overrides(Path(config), bus=bus, pace=pace, seed=seed, changes=changes)
        runs = Path("runs" if out is None else out)
        loaded = with_commissioned(loaded, runs, _on_standard_error)
        check_bench(loaded.config, loaded.document)
        if participants is Participants.IN_PROCESS:
            check_in_process(loaded.config)
        self._recorder: Recorder = Recorder(loaded.config.signals)
        self._made = datetime.now(UTC)
        tell = announce or (lambda text: None)
        if (known := commissioned_text(loaded.config.twin.priors, self._made)) is not None:
            tell(known)
        self._happened = EventLog(loaded.config.cycle_time_s)
        self._loaded, self._name = loaded, name
        self._out = None if out is None else Path(out)
        self._record: RunRecord | None = None
        self._recorded = False
        self.verdicts: list[CriterionResult] = []  #: what the script tests, for the result in the run folder
        super().__init__(
            loaded.config,
            observers=[self._recorder],
            participants=participants,
            announce=tell,
            warn=announce or _on_standard_error,
            journal=self._note_change,
            may_idle=True,
            force=force,
        )

    def __enter__(self) -> Self:
        if self._state.phase == "made":
            self._begin_record()
        try:
            super().__enter__()
        except BaseException as error:
            with finishing(WRITING):
                self._end_record(error)
            raise
        atexit.register(self._leave_forgotten)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        atexit.unregister(self._leave_forgotten)
        with finishing(WRITING):
            try:
                super().__exit__(kind, error, trace)
            except BaseException as failure:
                self._end_record(failure)
                raise
            self._end_record(error)

    @property
    def folder(self) -> RunFolder | None:
        """The run folder; None without `out`, or before the bench was entered."""
        return None if self._record is None else self._record.folder

    def _begin_record(self) -> None:
        if self._out is None:
            return
        # Who is refused the bus leaves no folder.
        self._resources.enter_context(held_bus(self.config, self._participants, force=self._force))
        self._bus_is_held = True
        try:
            record = self._record = RunRecord(
                self._loaded,
                self._out,
                self._participants,
                name=self._name,
                happened=self._happened,
            )
        except BaseException:
            self._resources.close()
            raise
        record.of(self)
        self._recorder = self._observers[0] = record.recorder
        self._tap, self._work_folder = record.trace, record.folder.path

    def _note_change(self, change: Change) -> None:
        if self._record is None:
            self._happened.add(change)
        else:
            self._record.note(change)

    def _end_record(self, error: BaseException | None) -> None:
        """Finish the run folder, once. `error`: what ended the bench."""
        record = self._record
        if record is None or self._recorded:
            return
        self._recorded = True
        for file in (record.trace, record.journal):
            with record.ending.kept("record"):
                file.close()
        if isinstance(error, AssertionError):
            self.verdicts.append(failed_or_passed("script", str(error) or "an assertion failed"))
        elif error is not None and not (isinstance(error, SystemExit) and not error.code):
            record.ending.add(error, "bench", self.fault_time_s)
        record.verdicts += self.verdicts
        outcome = record.finish(self, ())
        if outcome.recorded:
            try:
                remember(outcome.folder)
            except UnusableInputError as unusable:  # the run is no worse for it
                print(f"hilbench: not in the history: {unusable}", file=sys.stderr)

    def _leave_forgotten(self) -> None:
        """The program ends, and the bench still runs."""
        name = f"the bench '{self.config.name}'"
        print(f"hilbench: {name} was never left, and is stopped now; expected 'with Bench(…)'", file=sys.stderr)
        self.__exit__(InterruptedByOperatorError, InterruptedByOperatorError("the program has ended"), None)

    @property
    def recording(self) -> Recording:
        """Measurements until now, one row a cycle, as a copy."""
        return self._recorder.recording(self._made, self.config.description)

    def judge(self) -> Judgement:
        """Every step until now with its figures (`hilbench.runs.metrics`)."""
        return judge(self.recording.channels, journal=self._happened.events())

    def metrics(self) -> Metrics:
        """The metrics that the recording shows until now, of several steps the worst."""
        judged = self.judge()
        return Metrics(judged.metrics(), judged.not_judged())

    def step_response(
        self,
        path: str,
        to: float,
        *,
        line_speed_m_s: float = 3.0,
        ramp_s: float = 2.0,
        settle_s: float = 2.0,
        hold_s: float = 3.0,
    ) -> StepResponse:
        """Bring the line to its speed, let it settle, step a quantity, hold, and say what that did.

        Raises UnusableValueError for what can't be done, before anything moves.
        """
        to = quantities.checked_value(quantities.checked_path(path), to)
        quantities.checked_value(quantities.LINE_SPEED, line_speed_m_s)
        for name, given in (("ramp_s", ramp_s), ("settle_s", settle_s), ("hold_s", hold_s)):
            quantities.checked_duration_s(name, given, above_zero=name == "ramp_s")
        self.ramp(quantities.LINE_SPEED, line_speed_m_s, ramp_s)
        self.run(settle_s)
        self.step(path, to)
        step_time_s = self.events[-1].time_s
        self.run(hold_s)
        judged = self.judge()
        last = replace(judged, steps=judged.steps[-1:])
        reasons = last.not_judged()
        return StepResponse(self.recording, step_time_s, Metrics(last.metrics(), reasons), reasons)
