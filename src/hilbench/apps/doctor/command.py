"""`hilbench doctor`: a machine, its interfaces and nodes examined."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from typer import Argument, Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import BusOption, JsonOption, PaceOption, SetOption, print_json
from hilbench.apps.cli.tables import table
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED, UnusableInputError

if TYPE_CHECKING:
    from hilbench.apps.doctor.examination import Examination
    from hilbench.apps.doctor.findings import Finding

_COLOURS = {"ok": "green", "warning": "yellow", "error": "red"}


def doctor(
    config: Annotated[Path | None, Argument(metavar="[CONFIG]", help="bench config (YAML)")] = None,
    bus: BusOption = None,
    pace: PaceOption = None,
    changes: SetOption = None,
    start: Annotated[bool, Option(help="start simulated hardware and twin when they don't run, as run does")] = True,
    json: JsonOption = False,
) -> None:
    """Examine machine, CAN interface and nodes; says what is wrong and what to type. Writes nothing to any device.

    Exit code: 0 no error found (warnings may be), 1 errors found, 2 unusable input.

    Example: hilbench doctor bench_configs/web_section_step.yaml --bus socketcan:can0
    """
    from hilbench.apps.doctor.examination import examine
    from hilbench.apps.doctor.subject import Subject
    from hilbench.can.open import BusAddress

    if config is None and changes:
        raise UnusableInputError("--set", f"'{changes[0]}' without a config, expected CONFIG to change")
    if config is None:
        subject = Subject.of_bus(None if bus is None else BusAddress.parse(bus).as_it_runs())
    else:
        from hilbench.bench.check import check_bench

        loaded = load_config(config, bus=bus, pace=pace, changes=changes or ())
        check_bench(loaded.config, loaded.document)
        subject = Subject.of_bench(loaded.config, start=start)
    console = Console(highlight=False, quiet=json)
    # Plain lines: what redraws itself meanwhile would disturb the measurement of the timer.
    examination = examine(subject, lambda text: console.print(f"{text} ..."))
    _show(console, examination)
    if json:
        print_json(_as_data(examination))
    raise typer.Exit(EXIT_PASSED if examination.passed else EXIT_CRITERION_FAILED)


def _as_data(examination: Examination) -> dict[str, object]:
    """The examination for machines."""
    return {
        "passed": examination.passed,
        "errors": examination.count("error"),
        "warnings": examination.count("warning"),
        "nodes_asked": examination.nodes_asked,
        "findings": examination.findings,
        "timer_lateness": examination.lateness,
    }


def _show(console: Console, examination: Examination) -> None:
    """Print the examination for a person: findings with what was expected, then what to do."""
    rows = []
    for subject, findings in groupby(examination.findings, lambda finding: finding.subject):
        rows.append(("", "", f"[bold]{escape(subject)}[/bold]"))
        for finding in findings:
            colour = _COLOURS[finding.level]
            text = f"{finding.found}\nexpected {finding.expected}" if finding.expected else finding.found
            rows.append((f"[{colour}]{finding.level}[/{colour}]", finding.check.replace("_", " "), escape(text)))
    console.print(table(("level", "check", "found"), rows, ("level", "check"), show_header=False))
    _show_advice(console, examination.findings)
    errors, warnings = examination.count("error"), examination.count("warning")
    asked = examination.nodes_asked > 0
    colour = _COLOURS["error" if errors else "ok" if asked and not warnings else "warning"]
    counts = f"{_counted(errors, 'error')}, {_counted(warnings, 'warning')}"
    if not asked:
        counts = "no node was asked; of the rest: " + (
            counts if errors else f"{_counted(warnings, 'warning')}, no error"
        )
    console.print(f"[{colour}]{counts}[/{colour}]; what is checked: docs/real_stand.md")


def _show_advice(console: Console, findings: Sequence[Finding]) -> None:
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
