"""The gateway on TCP: a thread for each client, and one that reports bus events to all of them."""

from __future__ import annotations

import socket
import socketserver
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from hilbench.apps.gateway.session import NET, Session
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.identifiers import EMERGENCY, FUNCTION_CODE, HEARTBEAT, NmtState, node_of
from hilbench.errors import BusError

_LONGEST_LINE: Final = 1 << 16
_MOST_CLIENTS: Final = 16
_POLL_S: Final = 0.1
#: A client that takes nothing so long has gone.
_SEND_S: Final = 2.0


class Gateway(socketserver.ThreadingTCPServer):
    """Serves clients until `shutdown`. `new_session` makes what handles the lines of one."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, address: tuple[str, int], new_session: Callable[[], Session]) -> None:
        super().__init__(address, _Client)
        self.new_session = new_session
        self._clients: set[_Client] = set()
        self._lock = threading.Lock()

    def enter(self, client: _Client) -> bool:
        """A client has come. False: there are too many."""
        with self._lock:
            if len(self._clients) >= _MOST_CLIENTS:
                return False
            self._clients.add(client)
            return True

    def leave(self, client: _Client) -> None:
        """Remove a client that has disconnected."""
        with self._lock:
            self._clients.discard(client)

    def publish(self, line: str) -> None:
        """Send an event to all clients."""
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.send(line)

    def follow(self, link: Link, stop: Callable[[], bool]) -> None:
        """Publish boot-ups and EMCY of the bus until `stop()`. Raises BusError when the bus is lost."""
        link.set_filters([(HEARTBEAT, FUNCTION_CODE), (EMERGENCY, FUNCTION_CODE)])
        while not stop():
            for frame in link.receive(_POLL_S):
                event = event_of(frame)
                if event is not None:
                    self.publish(event)


def event_of(frame: Frame) -> str | None:
    """Event of a frame for clients (CiA 309-3): boot-up and EMCY; None: no event."""
    node_id = node_of(frame.can_id, HEARTBEAT)
    if node_id:
        return f"{NET} {node_id} BOOT_UP" if frame.data == NmtState.INITIALISING.heartbeat else None
    node_id = node_of(frame.can_id, EMERGENCY)
    if not node_id or len(frame.data) != 8:
        return None
    code, register = int.from_bytes(frame.data[:2], "little"), frame.data[2]
    return f"{NET} {node_id} EMCY 0x{code:04X} {register} {frame.data[3:].hex(' ').upper()}"


class _Client(socketserver.StreamRequestHandler):
    server: Gateway

    def setup(self) -> None:
        super().setup()
        self._sending = threading.Lock()
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def handle(self) -> None:
        if not self.server.enter(self):
            self.send(f"[0] ERROR:102 # {_MOST_CLIENTS} clients are connected already")
            return
        try:
            self._serve(self.server.new_session())
        except (OSError, BusError):
            return  # the client disconnected; a lost bus is reported by its follower
        finally:
            self.server.leave(self)

    def _serve(self, session: Session) -> None:
        while line := self.rfile.readline(_LONGEST_LINE):
            if not line.endswith(b"\n"):
                self.send(f"[0] ERROR:101 # a line of more than {_LONGEST_LINE} bytes")
                return
            answer = session.answer(line.decode("utf-8", errors="replace").strip())
            if answer is not None:
                self.send(answer)

    def send(self, line: str) -> None:
        """Send a line to the client; one that has disconnected, or takes nothing, is ignored."""
        with self._sending, suppress(OSError):
            self.connection.settimeout(_SEND_S)
            try:
                self.connection.sendall(line.encode() + b"\r\n")
            except TimeoutError:
                self.connection.shutdown(socket.SHUT_RDWR)
            finally:
                self.connection.settimeout(None)
