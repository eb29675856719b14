"""A packet that the hub passes on in one go: what comes out, and is counted, is what it is frame by frame."""

from __future__ import annotations

import select
import socket
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress

from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.can import protocol, requests
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from hilbench.can.hub import Hub
from hilbench.can.medium import Medium

FLAGS = st.sampled_from([0, 0, 0, REMOTE_FLAG, EXTENDED_FLAG, ERROR_FLAG])
RECORDS = st.tuples(
    st.integers(0, 0x803) | st.integers(0, 0x1FFFFFFF),
    FLAGS,
    st.integers(0, 9),
    st.binary(min_size=8, max_size=8),
)
#: Who sends, and what.
PACKETS = st.lists(st.tuples(st.integers(0, 2), st.lists(RECORDS, max_size=12), st.binary(max_size=2)), max_size=8)
#: What the three let pass: all, an identifier, nothing.
FILTERS = [None, [(0x001, 0x003)], []]


def delivered(packets: Sequence[tuple[int, list[tuple[int, int, int, bytes]], bytes]], *, alone: bool) -> object:
    """All that three stations get from a hub, and its counters."""
    with ExitStack() as resources:
        hub = Hub("test", resources.enter_context(closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))))
        resources.callback(hub._epoll.close)
        hub.settings = requests.Settings(timing="virtual")
        hub._medium = Medium(hub.settings.bitrate)
        others = []
        for filters in FILTERS:
            here, there = (
                resources.enter_context(closing(end))
                for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            )
            there.setblocking(False)
            others.append(there)
            client = hub.connect(here)
            client.filters, client.joined = filters, True
            hub._medium.join(client)
        came: list[list[bytes]] = [[] for _ in others]
        for sender, records, rest in packets:
            body = [protocol.CAN_RECORD.pack(number | flags, size, 0, data) for number, flags, size, data in records]
            header = protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0)
            others[sender].send(header + b"".join(body) + rest)
            hub._attend(list(hub._clients.values())[sender], select.EPOLLIN, alone=alone)
            hub._run()
            for at, there in enumerate(others):
                with suppress(BlockingIOError):
                    while True:
                        came[at].append(there.recv(protocol.PACKET_BYTES))
        return came, hub._medium.counters, hub._medium.free_ns, hub.malformed


@given(PACKETS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_in_one_go_and_frame_by_frame_are_alike(packets):
    assert delivered(packets, alone=True) == delivered(packets, alone=False)


def test_what_a_station_hears_of_a_packet_is_one_packet():
    records = [(number, 0, 8, bytes(8)) for number in range(8)]
    (_, second, third), counters, *_ = delivered([(0, records, b"")], alone=True)
    (packet,) = second
    heard = [record[0] for record in protocol.STAMPED_CAN_RECORD.iter_unpack(packet[protocol.HEADER.size :])]
    assert heard == [1, 5]
    assert third == []
    assert counters.frames == 8
