"""The pages of one server, put together: the frame, its files, and the rooms that were asked for."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from typing import Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from hilbench.apps.pages.access import Access, Guard, session_opened
from hilbench.apps.pages.live.viewer import Viewers
from hilbench.apps.report.page import page_text

#: Every file that there is to ask for, where it stands, and what it is.
_FILES: Final = {
    "live.js": ("pages/static/live.js", "text/javascript"),
    "axes.js": ("report/axes.js", "text/javascript"),
    "session.js": ("pages/static/session.js", "text/javascript"),
    "icon.svg": ("pages/static/icon.svg", "image/svg+xml"),
    "live.css": ("pages/static/live.css", "text/css"),
    "page.css": ("report/page.css", "text/css"),
    "uPlot.js": ("report/uplot/uPlot.iife.min.js", "text/javascript"),
    "uPlot.css": ("report/uplot/uPlot.min.css", "text/css"),
}


def site(access: Access, rooms: Sequence[BaseRoute], viewers: Viewers | None = None) -> Starlette:
    """The pages: `rooms` are further ones, `viewers` those of a bench."""
    apps = resources.files("hilbench.apps")
    files = {name: (apps.joinpath(path).read_bytes(), kind) for name, (path, kind) in _FILES.items()}

    async def front(request: Request) -> Response:
        return HTMLResponse(page_text("pages/front", live=viewers is not None, replay=False))

    async def file(request: Request) -> Response:
        if request.path_params["name"] not in files:
            raise HTTPException(404)
        content, kind = files[request.path_params["name"]]
        return Response(content, media_type=kind)

    async def session(request: Request) -> Response:
        if request.method == "POST":
            return session_opened(access, request.headers.get("authorization", ""))
        return Response(status_code=204 if access.knows(access.session_of(request.headers)) else 401)

    async def live(socket: WebSocket) -> None:
        assert viewers is not None, "the route is only there with them"
        await viewers.serve(socket)

    routes: list[BaseRoute] = [
        Route("/", front),
        Route("/static/{name}", file),
        Route("/session", session, methods=["GET", "POST"]),
        *([WebSocketRoute("/live", live)] if viewers is not None else []),
        *rooms,
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, access=access)])
