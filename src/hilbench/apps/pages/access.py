"""Access to the pages: by a token, and for requests that come from these pages alone.

The token is printed once, in the fragment of an address: a browser does not send that, the page's script hands it over
for a session cookie, and takes it out of the address. Names under which the pages may be requested are checked, so that
no other site can have its own name lead here (DNS rebinding); where a request comes from is checked, so that no other
site can use the session (CSRF). Source: OWASP cheat sheets on sessions, CSRF, and WebSockets.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections import OrderedDict
from contextlib import suppress
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

#: What everybody may ask for: a frame without anything in it, and what hands over the token.
_PUBLIC_FOLDER: Final = "/static/"
_PUBLIC: Final = frozenset({"/", "/session"})
#: Bytes of a request's body, at most.
_LARGEST_BODY: Final = 4096
_MOST_SESSIONS: Final = 256
_SAFE_METHODS: Final = frozenset({"GET", "HEAD"})
#: What a page may load: from here, and nothing that is in its own text.
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Access:
    """The token of one server, the sessions that it has opened, and the names under which it is requested.

    `host` and `port`: where it listens.
    """

    def __init__(self, host: str, port: int) -> None:
        self.token = secrets.token_urlsafe(32)
        self.host, self.port = host, port
        self.cookie = f"hilbench-{port}"  # a browser keeps cookies by host, whatever the port
        self._sessions: OrderedDict[str, None] = OrderedDict()
        self._names = {host.lower(), "localhost", socket.gethostname().lower()}

    def open_session(self, given: str) -> str | None:
        """The cookie of a new session for who has the token; None for anybody else."""
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            return None
        session = secrets.token_urlsafe(32)
        self._sessions[session] = None
        while len(self._sessions) > _MOST_SESSIONS:
            self._sessions.popitem(last=False)
        return session

    def knows(self, session: str) -> bool:
        """True if the session was opened."""
        return any(hmac.compare_digest(session.encode(), known.encode()) for known in self._sessions)

    def is_ours(self, host: str) -> bool:
        """True if a Host header names this server: a name that is known, or any address, which no name server gives."""
        name, colon, port = host.rpartition(":")
        if not colon or not port.isdecimal():
            name, port = host, "80"
        name = name.strip("[]").lower()
        return port == str(self.port) and (name in self._names or _is_address(name))


def _is_address(name: str) -> bool:
    with suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return False


class Guard:
    """Lets a request through to the pages if it may; every answer gets the headers that keep a browser strict."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request or connection (ASGI)."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        problem = self._problem(scope)
        if problem is None:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await WebSocketClose(code=1008, reason=problem[1])(scope, receive, send)
        else:
            status, text = problem
            await PlainTextResponse(text, status)(scope, receive, _with_headers(send))

    def _problem(self, scope: Scope) -> tuple[int, str] | None:
        """Status and text of a refusal."""
        headers, path = Headers(scope=scope), str(scope["path"])
        host, origin = headers.get("host", ""), headers.get("origin")
        changes = scope["type"] == "websocket" or scope["method"] not in _SAFE_METHODS
        if not self._access.is_ours(host):
            return 403, "this server is not asked by that name"
        if (origin is not None or changes) and origin != f"http://{host}":
            return 403, "the request comes from another site"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and path != "/":
            return 403, "the request comes from another site"
        length = headers.get("content-length", "0")
        known = length.isdecimal() and len(length) <= len(str(_LARGEST_BODY)) and int(length) <= _LARGEST_BODY
        if not known or "transfer-encoding" in headers:
            return 413, f"expected a body of at most {_LARGEST_BODY} bytes"
        if path in _PUBLIC or path.startswith(_PUBLIC_FOLDER):
            return None
        if not self._access.knows(HTTPConnection(scope).cookies.get(self._access.cookie, "")):
            return 401, "open the address that hilbench has printed in its terminal"
        return None


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sent


def session_opened(access: Access, given: str) -> Response:
    """The answer to who hands over a token."""
    session = access.open_session(given.removeprefix("Bearer "))
    if session is None:
        return PlainTextResponse("not the token of this server", 401)
    response = Response(status_code=204)
    response.set_cookie(access.cookie, session, httponly=True, samesite="strict", path="/")
    return response
