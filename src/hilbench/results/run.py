"""Runs the experiment of a config on its bench and leaves a run folder behind, whatever happens."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hilbench.bench.bench import Bench, CycleObserver, InterruptedByOperatorError
from hilbench.bench.lifecycle.participants import Participants, check_in_process
from hilbench.bench.lifecycle.startup import copies_beside, held_bus
from hilbench.bench.reports.change import Change
from hilbench.bench.reports.notice import Notice
from hilbench.crash_report import crash_report
from hilbench.errors import (
    EXIT_BENCH_FAULT,
    EXIT_CRITERION_FAILED,
    EXIT_INTERRUPTED,
    EXIT_PASSED,
    BenchFaultError,
    HilbenchError,
    UnusableInputError,
    printable,
)
from hilbench.exchange.timeliness import Timeliness
from hilbench.forked_workers import ForkedWorker
from hilbench.processes import HeldSignals, finishing
from hilbench.results.commissioned import commissioned_text
from hilbench.results.journal import JournalWriter
from hilbench.results.junit import write_junit
from hilbench.results.provenance import Provenance, commit_of
from hilbench.results.recording import read_recording
from hilbench.results.result import (
    Environment,
    Fault,
    FoundRecord,
    GapHistory,
    Late,
    Result,
    StreamRecord,
    Timing,
    Warned,
    jitter,
)
from hilbench.results.run_folder import RunFolder
from hilbench.results.spool import Spool
from hilbench.results.trace import TraceWriter
from hilbench.runs import config as config_files
from hilbench.runs.check import check_experiment
from hilbench.runs.config import LoadedConfig
from hilbench.runs.criteria import BY_OPERATOR, Criterion, CriterionResult, evaluate
from hilbench.runs.estimated_errors import metrics as found_metrics
from hilbench.runs.events import EventLog
from hilbench.runs.metrics import Judgement, judge
from hilbench.runs.set_point_schedule import LookAhead

#: What a signal waits for once a run has ended.
WRITING = "recording and result are written"


@dataclass
class RunOutcome:
    """Outcome of a run: its folder, its result, and the exit code it means."""

    folder: RunFolder
    result: Result
    exit_code: int

    def as_object(self) -> dict[str, Any]:
        """Object for a program: folder, files, exit code, verdict and what was overridden, and all that result.json
        has."""
        provenance = self.result.provenance
        return {
            "run": str(self.folder.path.resolve()),
            "exit_code": self.exit_code,
            "verdict": self.result.verdict,
            "files": {name: str(path.resolve()) for name, path in self.folder.files().items()},
            "overridden": {each.key: each.value for each in provenance.overridden} if provenance else {},
            **self.result.model_dump(mode="json"),
        }

    def end_if_asked(self, held: HeldSignals) -> None:
        """Set the exit code of an interruption, unless it is that of a fault: a signal came while files were
        written."""
        if held.asked is not None and self.exit_code != EXIT_BENCH_FAULT:
            self.exit_code = EXIT_INTERRUPTED
        held.asked = None

    @property
    def recorded(self) -> bool:
        """True if the run got as far as a recording; a report can be made only then."""
        return self.folder.recording.exists()


class Streamed(CycleObserver, Protocol):
    """An observer that hands the samples on, and says how many."""

    def record(self) -> StreamRecord:
        """Record of the stream until now."""


def run_experiment(
    loaded: LoadedConfig,
    out: Path,
    *,
    observers: Sequence[CycleObserver] = (),
    streams: Sequence[Streamed] = (),
    participants: Participants = Participants.STARTED,
    announce: Callable[[str], None] = lambda text: None,
    force: bool = False,
    beside: dict[str, ForkedWorker] | None = None,
) -> RunOutcome:
    """Run all steps of a config, evaluate its criteria, write the run folder (the report is made from it).

    A bench fault, an interruption, or an exception that nobody foresaw ends the run in the safe state; what was
    recorded until then is written, and the fault is in the result (the traceback in the run folder). Raises
    UnusableInputError before anything is started or written, for a bus that has another master, too (`force`: unless it
    was only received), BenchFaultError when the result can't be written. `beside`: copies of this process that were
    made before (`startup.copies_beside`).
    """
    config = loaded.config
    check_experiment(loaded)
    if participants is Participants.IN_PROCESS:
        check_in_process(config)
    if participants is not Participants.IN_PROCESS:
        announce(f"look who is on {config.bus_address}")
    made = copies_beside(config, participants) if beside is None else nullcontext(beside)
    with made as waiting, held_bus(config, participants, force=force):
        record = RunRecord(loaded, out, participants, announce=announce)
        bench = Bench(
            config,
            observers=[record.recorder, *observers, *streams],
            tap=record.trace,
            work_folder=record.folder.path,
            participants=participants,
            announce=announce,
            journal=record.note,
            bus_is_held=True,
            forked_workers=waiting,
        )
        record.of(bench)
        kept = record.ending.kept("bench", lambda: bench.fault_time_s)
        with finishing(WRITING, partial(_end_at_once, bench)) as held:
            with record.journal, kept, record.trace, bench:
                announce("run the experiment")
                look_ahead = LookAhead(config)
                for number, step in enumerate(config.steps):
                    bench.foresee(look_ahead.plan(number, bench.time_s))
                    step.run(bench, record.verdicts)
            outcome = record.finish(bench, config.criteria, streams)
            outcome.end_if_asked(held)
            return outcome


class RunRecord:
    """Record of a run: made before the bench, fed while it runs, finished after it.

    `recorder` is an observer of the bench; `trace` and `journal` are to be entered, or closed, by whoever runs it; one
    who keeps what `happened` anyway shares that. Raises UnusableInputError when the run folder can't be made.
    """

    def __init__(
        self,
        loaded: LoadedConfig,
        out: Path,
        participants: Participants,
        *,
        name: str | None = None,
        happened: EventLog | None = None,
        announce: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.config = loaded.config
        self.verdicts: list[CriterionResult] = []  #: what the experiment tests itself
        self._announce = announce
        asked = ThreadPoolExecutor(1, "git")  # while other things are done: a run starts sooner
        self._commit = asked.submit(commit_of, loaded.document.path)
        asked.shutdown(wait=False)
        self._provenance = Provenance.of(loaded.config, loaded.document, participants)
        self._happened = happened or EventLog(loaded.config.cycle_time_s)
        self._started = datetime.now(UTC)
        self.commissioned = commissioned_text(loaded.config.twin.priors, self._started)  #: what the twin begins with
        self.folder = RunFolder.create(out, name or loaded.config.name)
        config_files.dump(loaded.config, self.folder.config)
        self.ending = Ending(self.folder)
        self.journal = JournalWriter(self.folder.journal)
        frames = loaded.config.trace
        self.trace = TraceWriter(
            self.folder.trace,
            loaded.config.bus_address.channel,
            keep=1e6 * frames.keep_MB,
            part=1e6 * frames.part_MB,
            compress=frames.compress,
        )
        self.recorder = Spool(  #: observer of the bench
            self.folder,
            loaded.config.signals,
            self._started,
            loaded.config.description,
            loaded.config.cycle_time_s,
            around_events=loaded.config.recording.full_rate == "around_events",
        )

    def of(self, bench: Bench) -> None:
        """Attach to a bench: it warns when the disk takes no more; full rate is around its notices, too."""
        self.recorder.warn, self.trace.warn = partial(bench.note, "recording"), partial(bench.note, "trace")
        self.recorder.alarms = lambda: [notice.last_time_s for notice in bench.notices]

    def note(self, change: Change) -> None:
        """Keep what the bench did."""
        self.journal.write(change)
        self._happened.add(change)
        self.recorder.event(self._happened.time_s(change.cycle))

    def finish(self, bench: Bench, criteria: Sequence[Criterion], streams: Sequence[Streamed] = ()) -> RunOutcome:
        """Write recording and result of a bench that has been left. Raises BenchFaultError when it can't be done."""
        config, folder, ending = self.config, self.folder, self.ending
        ending.faults += [Fault(time_s=None, source="safe state", text=text) for text in bench.safe_state_problems]
        with ending.kept("record"):
            self._announce("write recording and result")
        ending.look_after_folder()
        timing = measure_timing(bench, len(self.recorder))
        with ending.kept("record"):
            self.recorder.finish()
        judged = Judgement(())
        if folder.recording.exists():
            with ending.kept("metrics"):
                judged = judge(read_recording(folder.recording).channels, journal=self._happened.events())
        prediction, changes = bench.prediction, bench.model_changes
        metrics = judged.metrics() | timing.metrics()
        if bench.twin_refusals is not None:
            metrics["twin_refusals"] = float(bench.twin_refusals)
        if prediction is not None:
            metrics |= prediction.announcements.metrics()
        found, history = None, None
        if changes is not None:
            metrics |= found_metrics(changes.changes)
            found = [record for change in changes.changes for record in FoundRecord.of(change)]
            history = GapHistory.of(changes.gaps, changes.changes, bench.experiment_time_s)
        verdicts = self.verdicts + evaluate(criteria, metrics, judged)
        warnings = [_warned(notice) for notice in bench.notices]
        environment = Environment.here(config.seed)
        result = Result.of(
            verdicts,
            metrics,
            timing,
            ending.faults,
            environment,
            judged=judged,
            predicted=None if prediction is None else prediction.announcements.made,
            estimated=bench.found_beside,
            began=self._started,
            provenance=self._provenance.model_copy(update={"git": self._commit.result()}),
            warnings=warnings or None,
            found=found,
            gap_history=history,
            streams=[stream.record() for stream in streams] or None,
            commissioned=self.commissioned,
        )
        try:
            result.write(folder.result)
            write_junit(result, config.name, self._started, folder.junit)
        except UnusableInputError as error:
            texts = "".join(f"{fault.text}; " for fault in ending.faults)
            raise BenchFaultError(f"{texts}drives were stopped; then {error}") from error
        if ending.exit_code == EXIT_PASSED and result.passed is False:
            ending.exit_code = EXIT_CRITERION_FAILED
        return RunOutcome(folder, result, ending.exit_code)


class Ending:
    """End of a run: the exit code of the first fault, and all faults."""

    def __init__(self, folder: RunFolder) -> None:
        self.exit_code = EXIT_PASSED
        self.faults: list[Fault] = []
        self._folder = folder

    @contextmanager
    def kept(self, source: str, time_s: Callable[[], float | None] = lambda: None) -> Iterator[None]:
        """Turn an exception of the block into a fault of `source`; it ends no more than the block."""
        try:
            yield
        except BaseException as error:
            self.add(error, source, time_s())

    def add(self, error: BaseException, source: str, time_s: float | None) -> None:
        """Add an exception as a fault of `source`, at `time_s` of the experiment."""
        if isinstance(error, InterruptedByOperatorError | KeyboardInterrupt):
            when = "during start" if source == "bench" else "while the run was written"
            self._add(EXIT_INTERRUPTED, time_s, BY_OPERATOR, str(error) or f"interrupted {when}")
        elif isinstance(error, HilbenchError):
            self._add(EXIT_BENCH_FAULT, time_s, source, str(error))
        else:  # unforeseen: reported like all others, with its traceback
            self._add(EXIT_BENCH_FAULT, time_s, source, crash_report(error, self._folder.traceback))

    def look_after_folder(self) -> None:
        """Somebody may have removed the run folder: what is still known is written all the same."""
        folder = self._folder
        if folder.trace.exists():
            return
        with suppress(OSError):  # what can't be written says so itself
            folder.path.mkdir(parents=True, exist_ok=True)
        text = f"{folder.path}: was removed while the run wrote to it, trace and journal are lost"
        self._add(EXIT_BENCH_FAULT, None, "record", text)

    def _add(self, exit_code: int, time_s: float | None, source: str, text: str) -> None:
        self.exit_code = self.exit_code or exit_code
        self.faults.append(Fault(time_s=time_s, source=source, text=printable(text)))


def _warned(notice: Notice) -> Warned:
    again: dict[str, Any] = (
        {"last_time_s": notice.last_time_s, "last_text": notice.last_text} if notice.count > 1 else {}
    )
    return Warned(time_s=notice.time_s, source=notice.source, text=notice.text, count=notice.count, **again)


def measure_timing(bench: Bench, recorded: int) -> Timing:
    """Counts and times of the cyclic path of a run that has ended, of which so many cycles were recorded; lateness only
    where SYNC had a deadline."""
    config, exchange = bench.config, bench.exchange
    if exchange is None:
        return Timing.of(config, 0)
    timing = exchange.timing
    bus_s = timing.cycles * config.cycle_time_s
    wall_s = (timing.ended_ns - timing.started_ns) * 1e-9
    lateness_us = np.asarray(exchange.pacing.lateness_ns, float) / 1000.0
    percentiles, histogram = jitter(lateness_us) if config.pace == "realtime" else (None, None)
    return Timing.of(
        config,
        recorded,
        exchange.pacing.missed,
        late_set_points=exchange.pacing.late_set_points if config.pace == "realtime" else None,
        jitter_us=percentiles,
        realtime_factor=bus_s / wall_s if wall_s > 0 else None,
        bus_load_pct=100.0 * timing.bits / (config.bus.bitrate * bus_s) if bus_s else None,
        lost_frames=exchange.lost_frames,
        first_loss_s=bench.experiment_time_s(timing.first_loss_cycle) if timing.first_loss_cycle else None,
        lost_frames_of={child.name: child.lost_frames for child in bench.children},
        late=_late(bench.timeliness),
        jitter_histogram=histogram,
    )


def _late(timeliness: Timeliness) -> dict[str, Late] | None:
    if not timeliness.cycles:
        return None
    return {
        name: Late(cycles=each.late, share_pct=100.0 * each.late / timeliness.cycles, oldest_cycles=each.oldest_cycles)
        for name, each in timeliness.of.items()
        if each.late
    }


def _end_at_once(bench: Bench) -> bool:
    """End a run between two cycles, so that the quick stop starts from a whole one; before the drives are enabled at
    once (KeyboardInterrupt), and not at all once the stop has begun."""
    if bench.stopping:
        return False
    if not bench.enabled:
        raise KeyboardInterrupt
    bench.request_interrupt()
    return True
