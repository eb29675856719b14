"""The runs in a folder, as pages: a list, and what became of one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from hilbench.errors import HilbenchError
from hilbench.pages.templates_of import page
from hilbench.report.live import policy
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.results.under_way import is_written

#: So many, the newest, are listed.
MOST: Final = 200
#: A report runs no scripts but those of a report, and can't act for who reads it, whatever stands in the file.
_REPORT_POLICY: Final = "sandbox allow-scripts; frame-ancestors 'none'; img-src data:; "


@dataclass(frozen=True)
class ListedRun:
    """One line of the list."""

    name: str
    changed: datetime
    verdict: str
    note: str
    has_report: bool


def verdict_of(result: Result) -> str:
    """In one word."""
    if any(fault.source == "operator" for fault in result.faults):
        return "interrupted"
    return "fault" if result.faults else "passed" if result.passed else "failed"


def runs_in(base: Path) -> list[RunFolder]:
    """The newest run folders, the newest first; none where there is no such folder."""
    try:
        found = [(entry.stat().st_mtime, entry.path) for entry in os.scandir(base) if entry.is_dir()]
    except OSError:
        return []
    folders = (RunFolder(Path(path)) for _, path in sorted(found, reverse=True))
    return [folder for folder in folders if folder.config.is_file()][:MOST]


def listed(folder: RunFolder) -> ListedRun:
    """What the list says of a run."""
    changed = datetime.fromtimestamp(folder.path.stat().st_mtime)
    verdict, note = "cut off", ""
    if folder.result.exists():
        try:
            result = Result.read(folder.result)
            verdict = verdict_of(result)
            failed = [each.name for each in result.criteria if not each.passed]
            note = "; ".join([*(fault.text for fault in result.faults), *failed])
        except HilbenchError as error:
            verdict, note = "unreadable", str(error)
    elif is_written(folder.trace):
        verdict = "running"
    return ListedRun(folder.name, changed, verdict, note, folder.report.is_file())


def routes(base: Path) -> list[Route]:
    """The pages of the runs in a folder."""

    def found(request: Request) -> RunFolder:
        name = request.path_params["name"]
        # By the names that are there: what is asked for never becomes a path.
        known = {folder.name: folder for folder in runs_in(base)}
        if name not in known:
            raise HTTPException(404, "no such run")
        return known[name]

    def all_runs() -> Response:
        return page("runs.html.j2", folder=str(base), runs=list(map(listed, runs_in(base))), most=MOST)

    def one_run(folder: RunFolder) -> Response:
        run, result = listed(folder), None
        if run.verdict not in ("unreadable", "running", "cut off"):
            result = Result.read(folder.result)
        return page("run.html.j2", run=run, result=result, warnings=result.all_warnings() if result else [])

    async def show_all(request: Request) -> Response:
        return await run_in_threadpool(all_runs)

    async def show(request: Request) -> Response:
        return await run_in_threadpool(one_run, found(request))

    async def report(request: Request) -> Response:
        folder = found(request)
        if not folder.report.is_file():
            raise HTTPException(404, "this run has no report")
        headers = {"Content-Security-Policy": _REPORT_POLICY + policy()}
        return FileResponse(folder.report, media_type="text/html; charset=utf-8", headers=headers)

    return [
        Route("/runs", show_all),
        Route("/runs/{name}", show),
        Route("/runs/{name}/report", report),
    ]
