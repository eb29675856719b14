"""Stations on a hub: four on one in this process, and a hub in its own that has loaded what forwards."""

from __future__ import annotations

import fcntl
import json
import socket
import termios
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st

from hilbench.can import hub as hub_module
from hilbench.can import protocol, requests
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.hub import Client, Hub
from hilbench.can.link import Link
from hilbench.can.medium import Medium

#: Few identifiers: the hub knows what it has passed on before, and several senders have the same.
IDENTIFIERS = st.integers(0, 5) | st.integers(0x7FE, 0x801) | st.sampled_from([0x1FFFFFFF, 0x80])
FLAGS = st.sampled_from([0, 0, 0, 0, 0, 0, REMOTE_FLAG, EXTENDED_FLAG, ERROR_FLAG])
RECORDS = st.tuples(
    IDENTIFIERS,
    FLAGS,
    st.sampled_from([0, 1, 8, 8, 8, 8, 9]),
    st.binary(min_size=8, max_size=8),
)
#: Who sends, what, and what is behind it that is no record.
PACKETS = st.lists(
    st.tuples(st.integers(0, 3), st.lists(RECORDS, max_size=12), st.sampled_from([b"", b"", b"", b"x"])), max_size=8
)
#: What the four let pass: all, an identifier, nothing, all of it one frame a packet.
FILTERS = [None, [(0x001, 0x003)], [], None]


class CountingHub(Hub):
    """Knows how many packets it has taken itself."""

    taken = 0

    def _take_frames(self, client: Client, packet: bytes) -> None:
        self.taken += 1
        super()._take_frames(client, packet)


def packet_of(records: Sequence[tuple[int, int, int, bytes]], rest: bytes = b"") -> bytes:
    body = [protocol.CAN_RECORD.pack(number | flags, size, 0, data) for number, flags, size, data in records]
    return protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0) + b"".join(body) + rest


class Stations:
    """Four on a hub of their own, which has not begun to serve them."""

    def __init__(self, resources: ExitStack, *, loaded: bool, timing: str = "virtual") -> None:
        listener = resources.enter_context(closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)))
        listener.bind("")  # to a name that the kernel finds
        listener.listen()
        self.address = listener.getsockname()
        resources.enter_context(pytest.MonkeyPatch.context()).setattr(hub_module, "GRACE_S", 0.0)
        self.hub = hub = CountingHub("test", listener)
        resources.callback(hub._epoll.close)
        if loaded:
            hub.load_forwarder()
        hub.settings = requests.Settings(timing=timing)
        hub._medium = Medium(hub.settings.bitrate)
        self.ends = []
        for filters in FILTERS:
            here, there = (
                resources.enter_context(closing(end))
                for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            )
            there.settimeout(20.0)
            self.ends.append(there)
            client = hub.connect(here)
            client.filters, client.joined = filters, True
            hub._medium.join(client)
        self.clients = list(hub._clients.values())
        self.clients[3].limit = 1
        self._serves = threading.Thread(target=hub.serve, args=(lambda: True,))
        resources.callback(lambda: self._serves.ident and self._serves.join())
        resources.callback(lambda: [end.close() for end in self.ends])

    def ask(self, **content: object) -> tuple[socket.socket, dict[str, Any]]:
        """A new connection, and the answer to a request over it."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.settimeout(20.0)
        connection.connect(self.address)
        connection.send(json.dumps(content).encode())
        return connection, json.loads(connection.recv(protocol.PACKET_BYTES))

    def serve(self) -> None:
        """From now on, until all have said their last."""
        self._serves.start()

    def await_taken(self) -> None:
        """Until somebody has taken all that was sent."""
        deadline_s = time.monotonic() + 20.0
        for end in self.ends:
            while fcntl.ioctl(end, termios.TIOCOUTQ, bytes(4)) != bytes(4):
                assert time.monotonic() < deadline_s, "the hub has not taken what was sent"
                time.sleep(1e-4)

    def say_no_more(self) -> None:
        """Once the hub has taken all that was sent."""
        self.await_taken()
        for end in self.ends:
            end.shutdown(socket.SHUT_WR)

    def left(self) -> list[list[bytes]]:
        """What each gets until the hub has ended."""
        return [list(iter(lambda end=end: end.recv(protocol.PACKET_BYTES), b"")) for end in self.ends]

    def counted(self) -> object:
        self._serves.join()
        return self.hub._medium.counters, self.hub._medium.free_ns, self.hub.malformed


def loads_its_forwarder(runtime: Any, link: Link, other: Link) -> int:
    """Send until the hub needs no interpreter; its process."""
    (pid,) = runtime.hubs()
    frames = [Frame(number, bytes(8)) for number in range(100)]

    def loaded() -> bool:
        for _ in range(50):
            link.send(frames)
            other.receive(20.0)
        return "llvmlite" in Path(f"/proc/{pid}/maps").read_text()

    assert runtime.eventually(loaded)
    return pid


def passes(sender: Link, receiver: Link, number: int) -> bool:
    """Whether a frame comes through within 10 s."""
    frame = Frame(0x100, number.to_bytes(4, "little"))
    sender.send([frame])
    deadline_s = time.monotonic() + 10.0
    while time.monotonic() < deadline_s:
        if any(came.data == frame.data for came in receiver.receive(0.1)):
            return True
    return False
