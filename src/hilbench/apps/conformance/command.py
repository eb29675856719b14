"""`hilbench conformance`: a CANopen device against CiA 301, CiA 402 and its own EDS file."""

from __future__ import annotations

import sys
from contextlib import closing
from itertools import groupby
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from typer import Option

from hilbench.apps.cli.options import ForceOption, JsonOption, print_json
from hilbench.apps.conformance.record import CaseResult, Examination, Verdict, counted, counts
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED, UnusableInputError

_FAILED_STEPS_SHOWN = 5


def conformance(
    bus: Annotated[str, Option(help="embedded:NAME, socketcan:can0, or another interface:channel")],
    node: Annotated[int, Option(min=1, max=127, help="node id of the device")],
    eds: Annotated[Path, Option(help="EDS or DCF file of the device")],
    allow_motion: Annotated[
        bool, Option("--allow-motion", help="power stage on, motor at 60 rpm and less; outputs are written")
    ] = False,
    allow_store: Annotated[
        bool, Option("--allow-store", help="1010h and 1011h are used; what was stored is stored again afterwards")
    ] = False,
    only: Annotated[list[str] | None, Option(metavar="GROUP", help="SDO, PDO, Option codes, …; repeatable")] = None,
    junit: Annotated[Path | None, Option(metavar="FILE", help="write the verdicts as JUnit XML")] = None,
    html: Annotated[
        Path | None, Option(metavar="FILE", help="write a page: each case, sent, expected and seen")
    ] = None,
    boot: Annotated[
        float, Option(metavar="S", min=0.1, help="longest time from a reset to the boot-up message")
    ] = 10.0,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Examine a CANopen device case by case: the 127 of CiA 301's conformance test, and those of CiA 402 for a drive.

    The cases are made from the EDS file; what it lacks is not applicable. The device is reset more than once. Nothing
    moves and nothing is stored unless allowed, and every parameter is written back.

    Exit code: 0 no case failed, 1 some failed, 2 unusable input, 3 no answer or the bus is lost, 130 interrupted.

    Example: hilbench conformance --bus socketcan:can0 --node 5 --eds eds/hilbench_servo.eds --html conformance.html

    Example: hilbench conformance --bus embedded --node 1 --eds eds/hilbench_servo.eds --only SDO --junit verdicts.xml
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.apps.conformance.description import Description
    from hilbench.apps.conformance.dut import DeviceUnderTest
    from hilbench.apps.conformance.examine import AFTERWARDS, examine
    from hilbench.apps.conformance.listing import listed_cases
    from hilbench.apps.conformance.reports import write_junit
    from hilbench.apps.conformance.wire import Wire
    from hilbench.processes import end_requests

    groups = list(dict.fromkeys(case.group for case in listed_cases()))
    unknown = [name for name in only or () if name not in groups]
    if unknown:
        raise UnusableInputError("--only", f"'{unknown[0]}', expected one of {', '.join(groups)}")
    description = Description(eds, node)
    console, width = Console(highlight=False, quiet=json), max(map(len, [*(only or groups), AFTERWARDS.group]))
    show_name = _show_name if sys.stderr.isatty() and not json else lambda _name: None
    cases: list[CaseResult] = []
    with BusSession(None, bus) as on:
        on.be_only_master(f"conformance of node {node}", force=force)
        wire = Wire(on.link(), on.enter_context(end_requests()))
        dut = DeviceUnderTest(wire, node, description, motion=allow_motion, store=allow_store, boot_s=boot)
        results = on.enter_context(closing(examine(dut, only or ())))
        for _, members in groupby(results, key=lambda case: case.group):
            ended = []
            for case in members:
                ended.append(case)
                show_name(case.name)
            show_name("")
            _show_group(console, ended, width)
            cases += ended
    name = description.od.device_information.product_name or eds.stem
    examination = Examination(name, node, str(on.bus), eds.name, cases)
    if junit is not None:
        write_junit(examination, junit)
    if html is not None:
        from hilbench.apps.conformance.reports import write_conformance_page

        write_conformance_page(examination, html)
    if json:
        print_json({**vars(examination), "counts": counts(cases)})
    else:
        _sum_up(console, examination, [path for path in (junit, html) if path is not None])
    raise typer.Exit(EXIT_CRITERION_FAILED if examination.failed else EXIT_PASSED)


def _show_group(console: Console, cases: list[CaseResult], width: int) -> None:
    """A line a group as it ends, and below it what failed."""
    failed = [case for case in cases if case.verdict == "failed"]
    colour = "red" if failed else "green"
    console.print(f"[{colour}]{cases[0].group:<{width}}[/]  {counted(cases)}", soft_wrap=True)
    for case in failed:
        console.print(f"  [red]{escape(case.name)}[/] {escape(case.title)} ({escape(case.clause)})", soft_wrap=True)
        wrong = [step for step in case.steps if not step.ok]
        for step in wrong[:_FAILED_STEPS_SHOWN]:
            text = f"    {step.what}: expected {step.expected}, seen {step.seen}"
            console.print(escape(text + (f", sent {step.sent}" if step.sent else "")), soft_wrap=True)
        if len(wrong) > _FAILED_STEPS_SHOWN:
            console.print(f"    and {len(wrong) - _FAILED_STEPS_SHOWN} more", soft_wrap=True)


def _show_name(name: str) -> None:
    """Say on a terminal which case has ended, until the next word."""
    print(f"\r{name:<40}" + ("" if name else "\r"), end="", file=sys.stderr, flush=True)


def _sum_up(console: Console, examination: Examination, written: list[Path]) -> None:
    verdict = "[red]failed[/]" if examination.failed else "[green]passed[/]"
    place = f"{escape(examination.device)}, node {examination.node_id}"
    console.print(f"{verdict}  {place}: {counted(examination.cases)}", soft_wrap=True)
    refused = {case.reason.rpartition(": ")[2] for case in examination.cases if case.verdict is Verdict.NOT_ALLOWED}
    if refused:
        console.print(f"more with {' and '.join(sorted(refused))}", soft_wrap=True)
    for path in written:
        console.print(escape(str(path)), soft_wrap=True)
