"""The page of a library of runs: found, sorted, drawn over time and compared in the browser, each with its report."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from hilbench.apps.library.index import RunEntry
from hilbench.apps.report.page import Program, page_text
from hilbench.files import write_whole

#: Rows for paper, and for a browser that runs no script.
_STATIC_ROWS: Final = 200
#: Results of runs that can't be played again (yet).
_NOT_PLAYED: Final = frozenset({"running"})
#: Of an entry, what the page's script knows as it is.
_IN_PAGE: Final = {"path", "bench", "began_s", "met", "criteria", "tags", "notes", "fault"}
#: Address of something of a run.
Link = Callable[[RunEntry], str]
COLUMNS: Final = ("Run", "Began", "Result", ">Criteria", ">Lasted, s", "Tags")


def write_runs_page(base: Path, runs: Sequence[RunEntry], path: Path) -> Path:
    """Write the page of these runs of the folder `base`, with links to their reports from where the page lies.

    Returns `path`. Raises UnusableInputError if it can't be written.
    """
    program = Program("library/runs.js", page_data(runs, lambda run: report_address(base, run, path)))
    write_whole(path, runs_text(base, runs, runs[:_STATIC_ROWS], program))
    return path


def report_address(base: Path, run: RunEntry, page: Path) -> str:
    """Address of the report of a run in the folder `base`, from where a page lies."""
    below = os.path.relpath(base.resolve(), page.resolve().parent)
    return quote(f"{Path(below).as_posix()}/{run.path}/report.html")


def runs_text(base: Path, runs: Sequence[RunEntry], shown: Sequence[RunEntry], program: Program) -> str:
    """The page of these runs of the folder `base`; without its `program` it has those that are `shown`."""
    rows, folder = [row(run) for run in shown], base.resolve().name
    return page_text(
        "library/runs", program=program, title="Runs", count=len(runs), folder=folder, columns=COLUMNS, rows=rows
    )


def row(run: RunEntry) -> tuple[str, ...]:
    """The table's text."""
    return (
        run.path,
        run.began,
        run.state,
        run.held,
        "" if run.duration_s is None else f"{run.duration_s:.1f}",
        ", ".join(run.tags),
    )


def page_data(runs: Sequence[RunEntry], link: Link, replay: Link | None = None) -> dict[str, Any]:
    """Data of the page's script: runs, and each metric as a list over them. `link`: address of a run's report,
    `replay`: address of its replay."""
    names = dict.fromkeys(name for run in runs for name in run.metrics)
    return {
        "runs": [
            {
                **run.model_dump(mode="json", include=_IN_PAGE),
                "began": run.began,
                "result": run.state,
                "duration_s": None if run.duration_s is None else round(run.duration_s, 3),
                "set": run.set_values,
                "link": link(run) if run.has_report else None,
                "replay": replay(run) if replay is not None and run.state not in _NOT_PLAYED else None,
            }
            for run in runs
        ],
        "metrics": {
            name: [None if (value := run.metrics.get(name)) is None else float(f"{value:.6g}") for run in runs]
            for name in names
        },
    }
