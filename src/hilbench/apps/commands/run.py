"""`hilbench run`: live progress, the closing table of criteria, and where the report is."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from hilbench.apps.cli.options import print_json
from hilbench.apps.cli.progress import RunObserver
from hilbench.apps.cli.tables import table
from hilbench.apps.report.panel import panels_of
from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import EXIT_CRITERION_FAILED, UnusableInputError
from hilbench.forked_workers import ForkedWorker
from hilbench.processes import finishing
from hilbench.results.commissioned import commissioned_text
from hilbench.results.result import Result, StepRecord, Timing
from hilbench.results.run import RunOutcome, Streamed, run_experiment
from hilbench.runs.config import LoadedConfig
from hilbench.runs.machines.web_line import shape_of_figures
from hilbench.runs.metrics import kind_of_figures
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample

#: What a signal waits for once a run has ended.
_WRITING = "report and history are written"
_COLOURS = {"passed": "green", "marginal": "yellow", "failed": "red", "error": "red"}


def run_command(
    loaded: LoadedConfig,
    out: Path,
    *,
    participants: Participants,
    with_report: bool,
    as_json: bool,
    beside: dict[str, ForkedWorker],
    force: bool = False,
    stream: Sequence[str] = (),
    require_criteria: bool = False,
) -> int:
    """Run the experiment, show it, and return the exit code; `stream`: where its samples go while it runs; `beside`:
    copies of this process for those that run beside the bench; `require_criteria`: a run that nothing judges fails."""
    console = Console(highlight=False, quiet=as_json)
    with ExitStack() as entered:
        streams: Sequence[Streamed] = []
        if stream:  # most runs need not load what streams do
            from hilbench.apps.streams.sinks import parse_target
            from hilbench.apps.streams.stream import streams_to

            streams = entered.enter_context(streams_to([parse_target(each) for each in stream], loaded.config))
        alone = participants is Participants.IN_PROCESS
        where = "in this process, on no bus: no monitor receives it" if alone else loaded.config.bus.address
        console.print(f"[bold]{loaded.config.name}[/bold]  {where}; {loaded.config.pace}")
        if (known := commissioned_text(loaded.config.twin.priors, datetime.now(UTC))) is not None:
            console.print(known, soft_wrap=True, markup=False)
        with Progress(console, loaded.config) as progress:
            outcome = run_experiment(
                loaded,
                out,
                observers=[] if as_json else [progress],
                streams=streams,
                participants=participants,
                announce=progress.announce,
                force=force,
                beside=beside,
            )
            with finishing(_WRITING) as held:
                if outcome.recorded and with_report:
                    progress.announce("write report")
                    _write_report(outcome)
                progress.end()
                show_outcome(console, outcome)
                _remember(outcome)
                outcome.end_if_asked(held)
    if require_criteria and outcome.result.verdict == "completed":
        outcome.exit_code = outcome.exit_code or EXIT_CRITERION_FAILED
        print("hilbench: nothing was judged, expected at least one criterion (--require-criteria)", file=sys.stderr)
    if as_json:
        print_json(outcome.as_object())  # ASCII, whatever reads it
    return outcome.exit_code


def _write_report(outcome: RunOutcome) -> None:
    """Write it; where it can't be, the result is there all the same, and a run without a fault ends with its code."""
    from hilbench.apps.report.html import write_report  # slow to import: not before the first SYNC

    try:
        write_report(outcome.folder)
    except UnusableInputError as error:
        Console(stderr=True, highlight=False).print(f"no report: {error}", soft_wrap=True, markup=False)
        outcome.exit_code = outcome.exit_code or error.exit_code


def _remember(outcome: RunOutcome) -> None:
    """Add what the run has found to the history of its stand; a run is no worse for a history that can't be written."""
    if outcome.recorded:
        from hilbench.apps.history.entries import remember  # not before the first SYNC, too

        try:
            remember(outcome.folder)
        except UnusableInputError as error:
            Console(stderr=True, highlight=False).print(f"not in the history: {error}", soft_wrap=True, markup=False)


class Progress(RunObserver):
    """Observer that shows the state of the run: a live table on a terminal, a line now and then elsewhere."""

    def __init__(self, console: Console, config: BenchConfig) -> None:
        live = console.is_terminal and not console.quiet  # else it would keep back what others print
        super().__init__(self._show_sample, config.cycle_time_s, on_terminal=live)
        self._panels = panels_of(config.machine.kind, config.shape).panels
        self._signals = {signal.name for signal in config.signals}
        self._console = console
        self._bits_per_cycle = config.bus.bitrate * config.cycle_time_s
        self._live = Live(console=console, auto_refresh=False, transient=True) if live else None
        self._started_s = time.monotonic()
        self._phase = ""

    def __enter__(self) -> Progress:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """Show nothing any more."""
        if self._live is not None:
            self._live.stop()

    def announce(self, text: str) -> None:
        """Say what the bench is doing now."""
        self._phase = text
        if self._live is None:
            self._console.print(text)
        else:
            self._live.update(text, refresh=True)

    def started(self, bench: Bench) -> None:
        """The cyclic path runs from now on."""
        self._started_s = time.monotonic()

    def _show_sample(self, sample: CycleSample) -> None:
        if self._live is not None:
            self._live.update(self._table(sample), refresh=True)
        else:
            self._console.print("  ".join(f"{name} {value}" for name, value in self._rows(sample)), soft_wrap=True)

    def _rows(self, sample: CycleSample) -> list[tuple[str, str]]:
        factor = max(0.0, sample.t_s) / max(1e-3, time.monotonic() - self._started_s)
        return [
            ("t", f"{sample.t_s:6.2f} s (real-time factor {factor:.1f})"),
            ("cycle", f"{sample.cycle:.0f}"),
            *filter(None, (panel.text(sample, self._signals) for panel in self._panels)),
            ("bus load", f"{100 * sample.bus_bits / self._bits_per_cycle:.0f} %"),
        ]

    def _table(self, sample: CycleSample) -> Table:
        return table(("name", "value"), self._rows(sample), show_header=False, padding=(0, 1), title=self._phase)


def show_outcome(console: Console, outcome: RunOutcome) -> None:
    """Print the criteria, the timing, the faults and where everything is."""
    result = outcome.result
    _show_criteria(console, result)
    if result.steps and len(result.steps) > 1:
        console.print(_steps_table(result.steps))
    console.print(_timing_line(result.timing))
    for warning in result.all_warnings():
        console.print(f"[yellow]warning[/yellow] {warning}", soft_wrap=True)
    for fault in result.faults:
        console.print(f"[red]fault[/red] {fault.source}: {fault.text}", soft_wrap=True)
    for stream in result.streams or []:
        console.print(f"stream to {stream.to}: {stream.samples - stream.dropped} samples", soft_wrap=True, markup=False)
    words = {"passed": "[green]passed[/]", "completed": "[yellow]completed, nothing judged[/]"}
    verdict = words.get(result.verdict, "[red]not passed[/]")
    folder = outcome.folder
    left = f"report: {folder.report}" if folder.report.exists() else f"result: {folder.result}"
    if not outcome.recorded:
        left = f"no recording; {left}"
    console.print(f"{verdict}   {left}", soft_wrap=True)


def _show_criteria(console: Console, result: Result) -> None:
    """Show the criteria; of a run that ended early, those without a verdict are one line."""
    left_out = [row for row in result.criteria if result.faults and row.value is None and not row.never]
    rows = [row for row in result.criteria if row not in left_out]
    if rows:
        cells = [
            (row.name, "-" if row.value is None else f"{row.value:.6g}", str(row.limit), row.unit, _marked(row.verdict))
            for row in rows
        ]
        columns = ("criterion", ">value", "limit", "unit", "")
        console.print(table(columns, cells, framed=True, title="Criteria"))
    for row in rows:
        if row.reason:
            console.print(f"{_marked(row.verdict)} {escape(row.name)}: {escape(row.reason)}", soft_wrap=True)
    if left_out:
        some = f"{len(left_out)} of {len(result.criteria)} criteria"
        console.print(f"[red]error[/red] {some} could not be judged: the run ended by the fault below", soft_wrap=True)


_MOST_STEPS = 20


def _steps_table(steps: list[StepRecord]) -> Table:
    judged = steps[0].figures | steps[0].reasons
    panels = panels_of(kind_of_figures(judged), shape_of_figures(judged)).panels
    of_steps = [each for panel in panels for each in panel.steps]
    shown = steps[:_MOST_STEPS]
    left_out = f", the first {_MOST_STEPS} of {len(steps)}" if len(steps) > _MOST_STEPS else ""
    unknown = any(metric in step.reasons for step in shown for _, metric in of_steps)
    caption = "?: never, or not judged; result.json and the report say why" if unknown else None
    figures = [f">{heading}" for heading, _ in of_steps]
    rows = [
        (f"{step.number}", f"{step.time_s:.3f}", escape(step.text), *(_figure(step, metric) for _, metric in of_steps))
        for step in shown
    ]
    whole = (">", ">at, s", *figures)
    columns = (">", ">at, s", "step", *figures)
    return table(columns, rows, whole, title=f"Steps{left_out}", caption=caption, caption_justify="left")


def _figure(step: StepRecord, metric: str) -> str:
    value = step.figures.get(metric)
    return f"{value:.3g}" if value is not None else "?" if metric in step.reasons else ""


def _timing_line(timing: Timing) -> str:
    parts = [f"{timing.cycles} cycles of {timing.cycle_us / 1000:g} ms, {timing.pace}"]
    if timing.realtime_factor is not None:
        parts.append(f"real-time factor {timing.realtime_factor:.1f}")
    if timing.jitter_us is not None:
        jitter = timing.jitter_us
        if timing.late_set_points:
            parts.append(f"{timing.late_set_points} with late set points")
        parts.append(f"{timing.missed} missed, SYNC late by {jitter.p50:.0f} µs (p50), {jitter.p99:.0f} µs (p99)")
    if timing.bus_load_pct is not None:
        parts.append(f"bus load {timing.bus_load_pct:.0f} %")
    if timing.lost_frames is not None:
        parts.append(f"{timing.lost_frames} frames lost")
    if timing.late:
        late = ", ".join(f"{each.share_pct:.1f} % of {name}" for name, each in timing.late.items())
        parts.append(f"late samples: {late}")
    return ", ".join(parts)


def _marked(verdict: str) -> str:
    return f"[{_COLOURS[verdict]}]{verdict}[/]"
