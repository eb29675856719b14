"""The runs in a folder, as pages: the library's, and the report of each."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from hilbench.apps.library.query import Library
from hilbench.apps.library.runs_page import Link, page_data, runs_text
from hilbench.apps.report.page import Program, policy, scripts
from hilbench.errors import UnusableInputError
from hilbench.results.run_folder import RunFolder

#: Beyond what the page of a report says itself: no script of another, and nothing may be done in the reader's name.
_REPORT_POLICY: Final = "sandbox allow-scripts; frame-ancestors 'none'; img-src data:; "
_LIST_POLICY: Final = "frame-ancestors 'none'; base-uri 'none'; form-action 'none'; "


def folder_of(base: Path, name: str) -> RunFolder | None:
    """The run of a name in a folder. A requested name never becomes a path: it is one of those that are there."""
    with suppress(UnusableInputError):
        if any(run.path == name for run in Library(base).runs()):
            return RunFolder(base / name)
    return None


def routes(base: Path, *, replays: bool = False) -> list[BaseRoute]:
    """The pages of the runs in a folder; `replays`: each can be played again (`hilbench.apps.pages.replay`)."""

    def all_runs() -> Response:
        try:
            runs = Library(base).runs()
        except UnusableInputError as error:
            return PlainTextResponse(f"No runs: {error}", 404)
        replay: Link | None = (lambda run: f"/replay/{quote(run.path)}") if replays else None
        program = Program("library/runs.js", page_data(runs, lambda run: f"/runs/{quote(run.path)}/report", replay))
        policies = {"Content-Security-Policy": _LIST_POLICY + policy(scripts(program.file))}
        return HTMLResponse(runs_text(base, runs, runs, program), headers=policies)

    def report_of(name: str) -> Response:
        folder = folder_of(base, name)
        if folder is None or not folder.report.is_file():
            raise HTTPException(404, "no such report")
        policies = {"Content-Security-Policy": _REPORT_POLICY + policy(scripts())}
        return FileResponse(folder.report, media_type="text/html; charset=utf-8", headers=policies)

    async def show_all(request: Request) -> Response:
        return await run_in_threadpool(all_runs)

    async def show_report(request: Request) -> Response:
        return await run_in_threadpool(report_of, request.path_params["name"])

    return [Route("/runs", show_all), Route("/runs/{name:path}/report", show_report)]
