"""`hilbench doctor`: findings as a table for people, or as one JSON object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from hilbench.apps.cli.options import print_json
from hilbench.apps.cli.tables import table
from hilbench.apps.doctor.examination import Examination, Start, Subject, examine
from hilbench.apps.doctor.findings import Finding, Level
from hilbench.can.open import BusAddress
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED

if TYPE_CHECKING:  # the models take their time to import; an examination without a config does not need them
    from hilbench.runs.config import LoadedConfig

_COLOURS = {Level.OK: "green", Level.WARNING: "yellow", Level.ERROR: "red"}


def doctor_command(loaded: LoadedConfig | None, bus: BusAddress | None, *, start: bool, as_json: bool) -> int:
    """Examine a bench (or a bus, or this machine alone), show what was found, and return the exit code."""
    console = Console(highlight=False, quiet=as_json)
    subject, start_nodes = (Subject.of_bus(bus), None) if loaded is None else _of_bench(loaded, start=start)
    # Plain lines: what redraws itself meanwhile would disturb the measurement of the timer.
    examination = examine(subject, start=start_nodes, announce=lambda text: console.print(f"{text} ..."))
    show(console, examination)
    if as_json:
        print_json(as_data(examination))
    return EXIT_PASSED if examination.passed else EXIT_CRITERION_FAILED


def _of_bench(loaded: LoadedConfig, *, start: bool) -> tuple[Subject, Start | None]:
    from hilbench.apps.doctor.bench_subject import starter, subject_of
    from hilbench.bench.check import check_bench

    check_bench(loaded.config, loaded.document)
    return subject_of(loaded.config), starter(loaded.config) if start else None


def as_data(examination: Examination) -> dict[str, object]:
    """The examination for machines."""
    return {
        "passed": examination.passed,
        "errors": examination.count(Level.ERROR),
        "warnings": examination.count(Level.WARNING),
        "nodes_asked": examination.nodes_asked,
        "findings": [asdict(finding) for finding in examination.findings],
        "timer_lateness": asdict(examination.lateness),
    }


def show(console: Console, examination: Examination) -> None:
    """Print the examination for a person: findings with what was expected, then what to do."""
    rows = []
    for subject, findings in groupby(examination.findings, lambda finding: finding.subject):
        rows.append(("", "", f"[bold]{escape(subject)}[/bold]"))
        for finding in findings:
            colour = _COLOURS[finding.level]
            text = f"{finding.found}\nexpected {finding.expected}" if finding.expected else finding.found
            rows.append((f"[{colour}]{finding.level}[/{colour}]", finding.check.replace("_", " "), escape(text)))
    console.print(table(("level", "check", "found"), rows, ("level", "check"), show_header=False))
    show_advice(console, examination.findings)
    errors, warnings = examination.count(Level.ERROR), examination.count(Level.WARNING)
    asked = examination.nodes_asked > 0
    colour = _COLOURS[Level.ERROR if errors else Level.OK if asked and not warnings else Level.WARNING]
    counts = f"{_counted(errors, 'error')}, {_counted(warnings, 'warning')}"
    if not asked:
        counts = "no node was asked; of the rest: " + (
            counts if errors else f"{_counted(warnings, 'warning')}, no error"
        )
    console.print(f"[{colour}]{counts}[/{colour}]; what is checked: docs/real_stand.md")


def show_advice(console: Console, findings: Sequence[Finding]) -> None:
    """Print what to do, each in a line of its own that can be copied, under a comment that says what for."""
    concerned: dict[str, list[str]] = {}
    for finding in findings:
        if finding.advice:
            concerned.setdefault(finding.advice, []).append(f"{finding.subject}: {finding.check.replace('_', ' ')}")
    if concerned:
        console.print("\n[bold]To do[/bold]")
    for advice, places in concerned.items():
        console.print(f"[dim]# {escape(', '.join(places))}[/dim]\n{escape(advice)}", soft_wrap=True)
    console.print()


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
