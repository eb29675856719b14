"""Packets that the hub forwards without the interpreter: what comes out, and is counted, is what it is with it."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Sequence
from contextlib import ExitStack, closing
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.can.hub_stations import PACKETS, Stations, loads_its_forwarder, packet_of

from hilbench.can import protocol
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.errors import BusError

#: Of a socket, in bytes: room for one packet of the most records, and a little.
_SHORT_BUFFER = 1 << 14


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
def test_the_last_words_of_who_leaves_without_having_read_all_are_heard(loaded):
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded)
        leaving = stations.ends.pop(1)
        stations.clients[1].connection.send(packet_of([(7, 0, 8, bytes(8))]))
        for number in (3, 4):
            leaving.send(packet_of([(number, 0, 8, bytes(8))]))
        leaving.close()
        stations.serve()
        packets = [stations.ends[0].recv(protocol.PACKET_BYTES) for _ in range(2)]
        stations.say_no_more()
        assert [protocol.STAMPED_CAN_RECORD.unpack(packet[protocol.HEADER.size :])[0] for packet in packets] == [3, 4]


@pytest.mark.parametrize("loaded", [True, False])
def test_what_a_station_hears_of_a_packet_is_one_packet(loaded):
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded)
        for _ in range(3):
            stations.ends[0].send(packet_of([(number, 0, 8, bytes(8)) for number in range(8)]))
        stations.serve()
        stations.say_no_more()
        _, second, third, single = stations.left()
        received = [
            [record[0] for record in protocol.STAMPED_CAN_RECORD.iter_unpack(packet[protocol.HEADER.size :])]
            for packet in second
        ]
        assert received == 3 * [[1, 5]]
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
@pytest.mark.parametrize(("loaded", "timing"), [(True, "virtual"), (False, "virtual"), (True, "real")])
def test_who_reads_late_has_lost_nothing(loaded, timing, reader):
    """Its socket is full in the middle of what it hears."""
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded, timing=timing)
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


@pytest.mark.parametrize(("loaded", "timing"), [(True, "virtual"), (False, "virtual"), (True, "real")])
def test_who_comes_goes_or_asks_while_packets_are_forwarded_is_served(loaded, timing):
    # The last of a packet is what the second station hears: then the wire is free, where time is real as well.
    frames = [(number, 0, 8, bytes(8)) for number in (0, 2, 3, 1)]
    with ExitStack() as resources:
        stations = Stations(resources, loaded=loaded, timing=timing)
        stations.serve()
        sender, narrow = stations.ends[0], stations.ends[1]

        def received(by: socket.socket, count: int) -> list[int]:
            """Where time is real, in as many packets as it takes."""
            found: list[int] = []
            while len(found) < count:
                body = by.recv(protocol.PACKET_BYTES)[protocol.HEADER.size :]
                found += [record[0] for record in protocol.STAMPED_CAN_RECORD.iter_unpack(body)]
            return found

        def passed(*by: tuple[socket.socket, int]) -> list[list[int]]:
            sender.send(packet_of(frames))
            return [received(*each) for each in by]

        assert [passed((narrow, 1)) for _ in range(2)] == 2 * [[[1]]]
        newcomer, joined = stations.ask(request="join")
        resources.enter_context(closing(newcomer))
        assert [passed((narrow, 1), (newcomer, 4)) for _ in range(2)] == 2 * [[[1], [0, 2, 3, 1]]]
        connection, answer = stations.ask(request="set_filters", station=joined["station"], filters=[[3, 0x7FF]])
        connection.close()
        assert answer == {}
        assert [passed((narrow, 1), (newcomer, 1)) for _ in range(2)] == 2 * [[[1], [3]]]
        connection, counted = stations.ask(request="statistics")
        connection.close()
        assert (counted["frames"], counted["stations"]) == (24, 5)
        assert timing == "real" or counted["time_ns"] == counted["bits"] * 1000
        newcomer.close()
        assert [passed((narrow, 1)) for _ in range(2)] == 2 * [[[1]]]
        stations.say_no_more()
        stations.left()
        stations.counted()


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
