"""The runs in a folder, as pages: the library's, and the report of each; and played again in the page of a running
bench, each viewer with a run of his own, from its trace and journal."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from math import inf, isinf
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from urllib.parse import quote

from pydantic import Field, ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from hilbench.apps.library.live_run import LiveRun
from hilbench.apps.library.query import Library
from hilbench.apps.library.runs_page import Link, page_data, runs_text
from hilbench.apps.pages.live.controls import ControlAnswer, ControlLock, Viewer
from hilbench.apps.pages.live.listener import Listener
from hilbench.apps.pages.live.viewer import Viewers
from hilbench.apps.report.page import Program, page_text, policy, scripts
from hilbench.block import Strict
from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.errors import BusError, HilbenchError, UnusableInputError
from hilbench.results.journal import JournalReader
from hilbench.results.run_folder import RunFolder
from hilbench.results.trace import TraceReader
from hilbench.runs.config import load

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
    """The pages of the runs in a folder; `replays`: each can be played again."""

    def show_all(request: Request) -> Response:
        try:
            runs = Library(base).runs()
        except UnusableInputError as error:
            return PlainTextResponse(f"No runs: {error}", 404)
        replay: Link | None = (lambda run: f"/replay/{quote(run.path)}") if replays else None
        program = Program("library/runs.js", page_data(runs, lambda run: f"/runs/{quote(run.path)}/report", replay))
        policies = {"Content-Security-Policy": _LIST_POLICY + policy(scripts(program.file))}
        return HTMLResponse(runs_text(base, runs, runs, program), headers=policies)

    def show_report(request: Request) -> Response:
        folder = folder_of(base, request.path_params["name"])
        if folder is None or not folder.report.is_file():
            raise HTTPException(404, "no such report")
        policies = {"Content-Security-Policy": _REPORT_POLICY + policy(scripts())}
        return FileResponse(folder.report, media_type="text/html; charset=utf-8", headers=policies)

    listed = [Route("/runs", show_all), Route("/runs/{name:path}/report", show_report)]
    return [*listed, *(_replays(base) if replays else [])]


#: Cycles that come at once at most.
_MOST_CYCLES: Final = 200
#: Runs that are played at a time: each is decoded by itself.
_MOST: Final = 4
_LONGEST_REASON: Final = 120


class PlayedTrace:
    """Link that receives the trace of a run, cycle by cycle at `pace` times the time in which it was run; 0:
    paused, infinite: as fast as it is taken. A cycle takes the same time in lockstep, where its trace does not
    state it. Raises UnusableInputError on reading, for a trace that can't be read.
    """

    controller = ControllerState.ERROR_ACTIVE
    dropped = None

    def __init__(self, folder: RunFolder, cycle_s: float, now: Callable[[], float] = time.monotonic) -> None:
        self.channel = folder.name
        self.pace = 1.0
        self._cycle_s = cycle_s
        self._now = now
        self._asked_s = now()
        self._played_s = 0.0
        self._cycles = 0
        self._frames: Iterator[Frame] = iter(TraceReader(folder.trace))
        self._over = False

    def clock_s(self) -> float:
        """The time that has been played."""
        return self._played_s

    def receive(self, timeout_s: float) -> list[Frame]:
        """Frames since the last call; waits for `timeout_s` where there are none."""
        asked_s = self._now()
        elapsed_s, self._asked_s = asked_s - self._asked_s, asked_s
        last = self._cycles + _MOST_CYCLES - 1
        if isinf(self.pace) and not self._over:
            self._played_s = last * self._cycle_s
        else:
            self._played_s += elapsed_s * (1.0 if isinf(self.pace) else self.pace)
            if not self._over:
                self._played_s = min(self._played_s, last * self._cycle_s)
        frames = list(self._due())
        if not frames:
            time.sleep(timeout_s)
        return frames

    def _due(self) -> Iterator[Frame]:
        while not self._over and self._cycles * self._cycle_s <= self._played_s:
            frame = next(self._frames, None)
            self._over = frame is None
            if frame is not None:
                self._cycles += frame.can_id == SYNC
                yield frame

    def send(self, frames: Sequence[Frame]) -> None:
        """Nothing can be sent. Raises BusError."""
        raise BusError(f"{self.channel} is played again, expected a bench that runs")

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        """Receive all frames, whatever the filters."""

    def fileno(self) -> int:
        """Nothing to wait for. Raises BusError."""
        raise BusError(f"{self.channel} is played again, expected a bus")

    def close(self) -> None:
        """End the replay."""
        self._frames, self._over = iter(()), True


#: As fast as it goes.
FAST: Final = inf


class Pace(Strict):
    """Pace of a replay: multiple of the original pace; none: as fast as possible."""

    do: Literal["pace"]
    pace: Annotated[float, Field(ge=0.0, le=1000.0)] | None


class Playing:
    """Viewers' requests to a replay."""

    def __init__(self, trace: PlayedTrace) -> None:
        self.control_lock = ControlLock()
        self._trace = trace

    def as_data(self) -> dict[str, Any]:
        """Possible requests, as data for the page."""
        return {"quantities": [], "switches": [], "replay": self._trace.channel}

    async def do(self, viewer: Viewer, asked: Mapping[str, Any]) -> ControlAnswer:
        """Execute a request and return its result."""
        try:
            pace = Pace.model_validate(asked).pace
        except ValidationError:
            return ControlAnswer(f"{self._trace.channel} is played again: nothing of that reaches a machine", False)
        self._trace.pace = FAST if pace is None else pace
        return ControlAnswer("", True)


def _replays(base: Path) -> list[BaseRoute]:
    """The pages of the ended runs in a folder."""
    playing: set[Listener] = set()

    def show(request: Request) -> Response:
        if folder_of(base, request.path_params["name"]) is None:
            raise HTTPException(404, "no such run")
        return HTMLResponse(page_text("pages/front", live=True, replay=True))

    async def play(socket: WebSocket) -> None:
        folder = await asyncio.to_thread(folder_of, base, socket.path_params["name"])
        try:
            if folder is None:
                raise UnusableInputError("run", "no such run")
            if len(playing) >= _MOST:
                raise UnusableInputError("replay", f"{_MOST} runs are played, expected no more")
            listener, controls = await asyncio.to_thread(_played, folder)
        except HilbenchError as error:
            await socket.accept()
            await socket.close(1008, str(error)[-_LONGEST_REASON:])
            return
        playing.add(listener)
        try:
            await Viewers(listener, controls).serve(socket)
        finally:
            playing.discard(listener)
            await asyncio.to_thread(listener.close)

    return [Route("/replay/{name:path}", show), WebSocketRoute("/played/{name:path}", play)]


def _played(folder: RunFolder) -> tuple[Listener, Playing]:
    """Raises UnusableInputError for a run that has no trace or journal, or a config of another version."""
    for file in (folder.trace, folder.journal):
        if not file.is_file():
            raise UnusableInputError(file.name, f"not in {folder.name}, expected that of an ended run")
    config, _ = load(folder.config)
    trace = PlayedTrace(folder, config.cycle_time_s)
    run = LiveRun(folder, JournalReader(folder.journal), is_played=True)
    listener = Listener(config, lambda: trace, lambda channel: run, trace.clock_s)
    listener.start()
    return listener, Playing(trace)
