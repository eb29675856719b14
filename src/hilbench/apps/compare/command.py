"""`hilbench compare`: runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hilbench.apps.cli.options import JsonOption, print_json


def compare(
    given: Annotated[list[str], Argument(metavar="RUN RUN...", help="run folders, names in --runs, or last")],
    out: Annotated[Path | None, Option(help="page with the signals in one picture each (HTML)")] = None,
    runs: Annotated[Path, Option(metavar="DIR", help="folder with the run folders")] = Path("runs"),
    json: JsonOption = False,
) -> None:
    """Compare runs: how their metrics differ from the first one's, and their signals in one picture.

    Example: hilbench compare runs/before-20260101-120000 runs/after-20260101-121500 --out compare.html
    """
    from dataclasses import asdict

    from hilbench.apps.compare.page import labels, metric_rows, read_runs, write_compare_page
    from hilbench.apps.library.query import find_run

    found = read_runs([find_run(each, runs).path for each in given])
    rows = metric_rows(found)
    if out is not None:
        write_compare_page(found, out)
    if json:
        names = [{"name": run.name, "verdict": run.verdict} for run in found]
        print_json({"runs": names, "metrics": [asdict(row) for row in rows]})
        return
    from rich.console import Console
    from rich.table import Table

    console, letters = Console(highlight=False), labels(found)
    for letter, run in zip(letters, found, strict=True):
        console.print(f"{letter}  {run.name}  {run.verdict}", soft_wrap=True)
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("metric")
    for heading in (*letters, *(f"{letter} − A" for letter in letters[1:])):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for row in rows:
        cells = ["-" if value is None else f"{value:.5g}" for value in (*row.values, *row.differences)]
        table.add_row(row.metric, *cells, row.unit)
    console.print(table)
    if out is not None:
        console.print(f"page: {out}", soft_wrap=True)
