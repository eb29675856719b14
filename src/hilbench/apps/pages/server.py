"""The server of the pages: a process of its own, which has no part in what a bench does."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Final

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from hilbench.apps.library.live_run import LiveRun
from hilbench.apps.monitor.changes import PATIENCE_S, ChangeRequests
from hilbench.apps.pages.access import Access, Guard, session_opened
from hilbench.apps.pages.live.controls import Controls
from hilbench.apps.pages.live.listener import Listener
from hilbench.apps.pages.live.viewer import Viewers
from hilbench.apps.pages.runs import routes
from hilbench.apps.report.page import page_text
from hilbench.can.open import open_link, open_python_can
from hilbench.canopen.sdo_client import SDO_ANSWERS, SdoClient
from hilbench.errors import UnusableInputError
from hilbench.topology.config import BenchConfig

#: Every file that may be requested, its place, and what it is.
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
LOOPBACK: Final = "127.0.0.1"
PORT: Final = 8321
#: Bytes of a message of a viewer, and of the head of a request, at most.
_LARGEST_MESSAGE, _LARGEST_HEAD = 4096, 16_384
#: A viewer from whom nothing is received for so long is gone, s.
_PING_S: Final = 10.0
#: Connections that are not a viewer's.
_MOST_CONNECTIONS: Final = 128


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
        return Response(status_code=204 if access.knows(request.cookies.get(access.cookie, "")) else 401)

    async def live(socket: WebSocket) -> None:
        assert viewers is not None, "the route is only there with them"
        await viewers.serve(socket)

    known: list[BaseRoute] = [
        Route("/", front),
        Route("/static/{name}", file),
        Route("/session", session, methods=["GET", "POST"]),
        *([WebSocketRoute("/live", live)] if viewers is not None else []),
        *rooms,
    ]
    return Starlette(routes=known, middleware=[Middleware(Guard, access=access)])


class _Connection(H11Protocol):
    """A new connection; of more than `_MOST_CONNECTIONS` the oldest ends: silent ones block no others."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.made_s = self.loop.time()
        known = [connection for connection in self.connections if isinstance(connection, _Connection)]
        if len(known) > _MOST_CONNECTIONS:
            oldest = min(known, key=lambda connection: connection.made_s)
            self.connections.discard(oldest)
            oldest.transport.abort()


class _ViewersConnection(WebSocketsSansIOProtocol):
    """A viewer's connection, which ends when he is silent, also where he does not take what was sent."""

    def keepalive_timeout(self) -> None:
        self.transport.abort()


def serve(config: BenchConfig | None, runs: Path, host: str, port: int, announce: Callable[[str], None]) -> None:
    """Serve the pages of the runs in a folder and, with a config, of the bench that runs by it, until it is ended.

    `port`: 0 for any that is free. `announce` gets the lines for who has started it: the address with the token.
    Raises UnusableInputError where it can't listen there, BusError where the bus can't be joined.
    """
    with ExitStack() as resources:
        listening = resources.enter_context(_listening(host, port))
        access = Access(host, listening.getsockname()[1])
        viewers = None if config is None else resources.enter_context(_bench(config, runs))
        # Beside a bench nothing is played: it would take the processor from it, and could be taken for it.
        app = site(access, routes(runs, replays=config is None), viewers)
        shown = f"[{host}]" if ":" in host else host
        announce(f"page: http://{shown}:{access.port}/#{access.token}")
        if host != LOOPBACK:
            announce(
                "everyone with this address can stop the machine and change what it does; it is not encrypted: "
                "expected in a network of your own, or at the end of a tunnel (ssh -L)"
            )
        server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_level="warning",
                lifespan="off",
                server_header=False,
                ws=_ViewersConnection,
                ws_per_message_deflate=False,  # a few kB a second, and most of what each viewer would cost
                ws_max_size=_LARGEST_MESSAGE,
                ws_ping_interval=_PING_S,
                ws_ping_timeout=_PING_S,
                http=_Connection,
                h11_max_incomplete_event_size=_LARGEST_HEAD,
                timeout_graceful_shutdown=1,
            )
        )
        with suppress(KeyboardInterrupt):  # that is how it is ended
            server.run(sockets=[listening])


@contextmanager
def _listening(host: str, port: int) -> Iterator[socket.socket]:
    place = f"--host {host} --port {port}"
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.create_server((host, port), family=family, backlog=64)
    except OSError as error:
        raise UnusableInputError(
            place, f"{error.strerror}, expected an address of this machine and a free port"
        ) from error
    with listening:
        yield listening


@contextmanager
def _bench(config: BenchConfig, runs: Path) -> Iterator[Viewers]:
    address = config.bus_address.as_it_runs  # asked each time: another run may have made the bus anew
    listener = Listener(config, lambda: open_link(address()), partial(LiveRun.on, runs))
    changes = ChangeRequests(config, lambda: SdoClient(open_python_can(address(), SDO_ANSWERS), PATIENCE_S))
    listener.start()
    with closing(listener), closing(changes):
        yield Viewers(listener, Controls(listener, changes))
