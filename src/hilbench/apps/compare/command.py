"""`hilbench compare`: runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hilbench.apps.cli.options import JsonOption, RunsOption, print_json


def compare(
    given: Annotated[list[str], Argument(metavar="RUN RUN...", help="run folders, names in --runs, or last")],
    out: Annotated[Path | None, Option(help="page with the signals in one picture each (HTML)")] = None,
    runs: RunsOption = Path("runs"),
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

    from hilbench.apps.cli.tables import table

    console, letters = Console(highlight=False), labels(found)
    for letter, run in zip(letters, found, strict=True):
        console.print(f"{letter}  {run.name}  {run.verdict}", soft_wrap=True)
    columns = ("metric", *(f">{letter}" for letter in letters), *(f">{letter} − A" for letter in letters[1:]), "unit")
    cells = [["-" if value is None else f"{value:.5g}" for value in (*row.values, *row.differences)] for row in rows]
    console.print(table(columns, [(row.metric, *of_row, row.unit) for row, of_row in zip(rows, cells, strict=True)]))
    if out is not None:
        console.print(f"page: {out}", soft_wrap=True)
