"""Packets that the hub forwards without the interpreter: what comes out, and is counted, is what it is with it."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import socket
import termios
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.can import hub as hub_module
from hilbench.can import protocol, requests
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.hub import Client, Hub
from hilbench.can.link import Link
from hilbench.can.medium import Medium
from hilbench.can.open import BusAddress, open_link
from hilbench.errors import BusError

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
#: Of a socket, in bytes: room for one packet of the most records, and a little.
_SHORT_BUFFER = 1 << 14


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

    def __init__(self, resources: ExitStack, *, loaded: bool) -> None:
        listener = resources.enter_context(closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)))
        listener.bind("")  # to a name that the kernel finds
        listener.listen()
        self.address = listener.getsockname()
        resources.enter_context(pytest.MonkeyPatch.context()).setattr(hub_module, "GRACE_S", 0.0)
        self.hub = hub = CountingHub("test", listener)
        resources.callback(hub._epoll.close)
        if loaded:
            hub.load_forwarder()
        hub.settings = requests.Settings(timing="virtual")
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

    def say_no_more(self) -> None:
        """Once the hub has taken all that was sent."""
        deadline_s = time.monotonic() + 20.0
        for end in self.ends:
            while fcntl.ioctl(end, termios.TIOCOUTQ, bytes(4)) != bytes(4):
                assert time.monotonic() < deadline_s, "the hub has not taken what was sent"
                time.sleep(1e-4)
        for end in self.ends:
            end.shutdown(socket.SHUT_WR)

    def left(self) -> list[list[bytes]]:
        """What each gets until the hub has ended."""
        return [list(iter(lambda end=end: end.recv(protocol.PACKET_BYTES), b"")) for end in self.ends]

    def counted(self) -> object:
        self._serves.join()
        return self.hub._medium.counters, self.hub._medium.free_ns, self.hub.malformed


def delivered(packets: Sequence[tuple[int, list[tuple[int, int, int, bytes]], bytes]], *, loaded: bool) -> object:
    """All that four stations get, and what the hub has counted; the first packets of all compete, then the second."""
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded)
        for sender, records, rest in packets:
            stations.ends[sender].send(packet_of(records, rest))
        stations.serve()
        stations.say_no_more()
        return stations.left(), stations.counted()


@given(PACKETS, st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_with_and_without_the_interpreter_packets_are_alike(packets, times):
    assert delivered(times * packets, loaded=True) == delivered(times * packets, loaded=False)


@pytest.mark.parametrize("loaded", [True, False])
def test_what_a_station_hears_of_a_packet_is_one_packet(loaded):
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded)
        for _ in range(3):
            stations.ends[0].send(packet_of([(number, 0, 8, bytes(8)) for number in range(8)]))
        stations.serve()
        stations.say_no_more()
        _, second, third, single = stations.left()
        heard = [
            [record[0] for record in protocol.STAMPED_CAN_RECORD.iter_unpack(packet[protocol.HEADER.size :])]
            for packet in second
        ]
        assert heard == 3 * [[1, 5]]
        assert third == []
        assert len(single) == 24
        assert stations.hub.taken == (1 if loaded else 3)


#: Frames that compete: two lengths of each identifier.
COMPETING = [(number, 0, size) for number in (0x001, 0x080, 0x185, 0x7FF) for size in (1, 8)]
PACKET = st.lists(st.tuples(st.sampled_from(COMPETING), st.binary(min_size=8, max_size=8)), min_size=1)
ROUNDS = st.lists(st.lists(PACKET, max_size=4), min_size=2, max_size=4)


@given(ROUNDS)
@settings(max_examples=60, deadline=None)
def test_known_frames_of_several_stations_compete_as_any(rounds):
    """By their identifiers, and who joined first; the first packet of each makes them known."""
    packets = [(sender, [(*frame, bytes(8)) for frame in COMPETING], b"") for sender in (2, 0, 3, 1)]
    packets += [
        (sender, [(*frame, data) for frame, data in records], b"")
        for each in rounds
        for sender, records in enumerate(each)
    ]
    assert delivered(packets, loaded=True) == delivered(packets, loaded=False)


@pytest.mark.parametrize("reader", [0, 3])
@pytest.mark.parametrize("loaded", [True, False])
def test_who_reads_late_has_lost_nothing(loaded, reader):
    """Its socket is full in the middle of what it hears."""
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded)
        stations.clients[reader].connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SHORT_BUFFER)
        stations.serve()
        came: list[tuple[int, int, int]] = []

        def read_until(frames: int) -> None:
            while len(came) < frames:
                packet = stations.ends[reader].recv(protocol.PACKET_BYTES)
                assert protocol.HEADER.unpack_from(packet)[1] == 0
                for can_id, _, _, data, time_ns in protocol.STAMPED_CAN_RECORD.iter_unpack(
                    packet[protocol.HEADER.size :]
                ):
                    came.append((int.from_bytes(data, "little"), can_id, time_ns))

        for at in range(40):
            stations.ends[1].send(packet_of([(number, 0, 8, at.to_bytes(8, "little")) for number in range(100)]))
            if at == 0:
                read_until(100)  # known from now on
        read_until(4000)
        assert [(at, number) for at, number, _ in came] == [(at, number) for at in range(40) for number in range(100)]
        assert all(before[2] < behind[2] for before, behind in pairwise(came))
        stations.say_no_more()
        stations.left()
        stations.counted()


@pytest.mark.parametrize("loaded", [True, False])
def test_who_comes_goes_or_asks_while_packets_are_forwarded_is_served(loaded):
    frames = [(number, 0, 8, bytes(8)) for number in range(4)]
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded)
        stations.serve()
        sender, narrow = stations.ends[0], stations.ends[1]

        def heard(by: socket.socket) -> list[int]:
            body = by.recv(protocol.PACKET_BYTES)[protocol.HEADER.size :]
            return [record[0] for record in protocol.STAMPED_CAN_RECORD.iter_unpack(body)]

        def passed(*by: socket.socket) -> list[list[int]]:
            sender.send(packet_of(frames))
            return [heard(each) for each in by]

        assert [passed(narrow) for _ in range(2)] == 2 * [[[1]]]
        newcomer, joined = stations.ask(request="join")
        assert [passed(narrow, newcomer) for _ in range(2)] == 2 * [[[1], [0, 1, 2, 3]]]
        connection, answer = stations.ask(request="set_filters", station=joined["station"], filters=[[2, 0x7FF]])
        connection.close()
        assert answer == {}
        assert [passed(narrow, newcomer) for _ in range(2)] == 2 * [[[1], [2]]]
        connection, counted = stations.ask(request="statistics")
        connection.close()
        assert (counted["frames"], counted["stations"]) == (24, 5)
        assert counted["time_ns"] == counted["bits"] * 1000
        newcomer.close()
        assert [passed(narrow) for _ in range(2)] == 2 * [[[1]]]
        stations.say_no_more()
        stations.left()
        stations.counted()


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


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_hub_that_ends_while_it_forwards_is_a_lost_bus(runtime, number):
    bus = BusAddress(timing="virtual")
    with closing(open_link(bus)) as one, closing(open_link(bus)) as other:
        pid = loads_its_forwarder(runtime, one, other)
        os.kill(pid, number)
        with pytest.raises(BusError, match="hilbench0"):
            other.receive(20.0)
    assert runtime.eventually(lambda: not runtime.hubs())
    if number == signal.SIGKILL:  # who comes next takes its place
        with closing(open_link(bus)) as one, closing(open_link(bus)) as other:
            one.send([Frame(0x1, b"")])
            assert other.receive(20.0)
