"""`hilbench fmu`: machines as FMUs for other tools, and what there is in an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from hilbench.plant.fmu.export.machine import ExportedMachine

app = typer.Typer(help="machines as FMUs (FMI 2 and 3, co-simulation)", no_args_is_help=True)


@app.command()
def export(
    machine: Annotated[Path, Option(metavar="CONFIG", help="bench config or model file")],
    output: Annotated[Path, Option(metavar="FILE.fmu", help="the file to write")],
    drive: Annotated[
        bool, Option("--drive", help="with the control loops of its drives: speeds go in, not torques")
    ] = False,
    load: Annotated[
        bool, Option("--load", help="what load motors emulate of it: speeds go in, torques come out")
    ] = False,
    fmi: Annotated[int, Option(min=2, max=3, help="version of FMI")] = 3,
) -> None:
    """Write a machine as an FMU that needs neither hilbench nor Python where it runs.

    A C compiler links it; it runs on systems as this one. The first export of a kind of machine compiles its kernel,
    which takes up to a minute.

    Example: hilbench fmu export --machine bench_configs/web_section_step.yaml --load --output web.fmu

    Example: hilbench fmu export --machine bench_configs/servo_axis.yaml --drive --fmi 2 --output servo.fmu
    """
    from hilbench.plant.fmu.export.archive import write_fmu

    if drive and load:
        raise typer.BadParameter("--drive and --load exclude each other")
    exported = _exported(machine, drive=drive, load=load)
    write_fmu(exported, 2 if fmi == 2 else 3, output)
    print(f"{output}: {exported.description}, FMI {fmi}")
    _list([(each.causality, each.quantity.name, each.quantity.unit) for each in exported.variables])


def _exported(path: Path, *, drive: bool, load: bool) -> ExportedMachine:
    from hilbench.apps.cli.model_option import any_model_from
    from hilbench.machine_kinds import machine_part

    machine = any_model_from(path)
    try:
        exported: ExportedMachine = machine_part(machine.kind, "fmu_export")(machine, drives=drive, load=load)
    except ValueError as error:
        raise UnusableInputError(path, f"the machine is a {machine.kind}, expected {error}") from None
    return exported


@app.command()
def show(file: Annotated[Path, Argument(metavar="FILE.fmu", help="an FMU")]) -> None:
    """Say what an FMU is and which variables it has, as a config names them.

    Example: hilbench fmu show web.fmu
    """
    from hilbench.plant.fmu.description import read_fmu

    found = read_fmu(file)
    print(found.summary)
    _list([(each.causality, each.name, each.unit) for each in found.variables.values()])


def _list(variables: list[tuple[str, str, str]]) -> None:
    for causality in ("input", "output", "parameter", "local"):
        names = [
            name if unit in ("", "1") else f"{name} [{unit}]" for kind, name, unit in variables if kind == causality
        ]
        if names:
            print(f"{causality}s: {', '.join(names)}")
