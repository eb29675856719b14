"""`hilbench report`: a report written anew."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from hilbench.apps.cli.options import RunArgument
from hilbench.errors import UnusableInputError


def report(
    run_folder: RunArgument,
    pictures: Annotated[
        Path | None, Option(metavar="DIR", help="write its pictures alone, each as a file in DIR")
    ] = None,
    form: Annotated[
        str | None, Option("--format", metavar="FORMAT", help="of the pictures: svg or png", show_default="svg")
    ] = None,
) -> None:
    """Write the report of a run folder anew, or its pictures one by one.

    Example: hilbench report runs/web_section_step-20260101-120000

    Example: hilbench report runs/web_section_step-20260101-120000 --pictures pictures --format png
    """
    from hilbench.apps.report.html import write_pictures, write_report
    from hilbench.results.run_folder import RunFolder

    if form not in (None, "svg", "png"):
        raise UnusableInputError("--format", f"'{form}', expected svg or png")
    if form is not None and pictures is None:
        raise UnusableInputError("--format", "without --pictures, expected a folder for the pictures")
    folder = RunFolder.open(run_folder)
    if pictures is None:
        print(write_report(folder))
    else:
        print(*write_pictures(folder, pictures, "png" if form == "png" else "svg"), sep="\n")
