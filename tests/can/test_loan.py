"""A wire that is lent to a station: the same bits as the hub's, nothing is lost, and nobody hangs."""

from __future__ import annotations

import os
import random
import signal
import socket
import time
import uuid
from collections.abc import Sequence
from contextlib import ExitStack, closing
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from numba import types
from tests.can.hub_stations import PACKETS, Stations, loads_its_forwarder, packet_of, passes
from tests.tiers import slow

from hilbench.can import hub_client, loan, loan_kernel, protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG
from hilbench.can.loan import Loan
from hilbench.can.open import BusAddress, open_link
from hilbench.compiled import COUNT, INDICES, TABLE
from hilbench.errors import BusError

#: Longer than a hub that has to say something takes for it.
_PATIENCE_MS = 2000
_ROOM = protocol.PACKET_BYTES // 8
OCTETS = types.Array(types.uint8, 1, "C")


class Borrower:
    """The first of the stations, which asks for the wire before each packet that anybody sends."""

    def __init__(self, stations: Stations) -> None:
        self._ends = stations.ends
        self.heard: list[bytes] = []
        self.loans: list[Loan] = []
        self._room = np.zeros(_ROOM, np.int64)
        self.passed = 0  #: packets that went by without the hub

    @property
    def _table(self) -> Any:
        return self.loans[-1].table if self.loans else loan.NO_WIRE

    def ask(self) -> bool:
        """Whether it has the wire now."""
        if not loan_kernel.has(self._table):
            self.close()
            lent, came = loan.ask(self._ends[0])
            self.heard += came
            self.loans += [] if lent is None else [lent]
        return loan_kernel.has(self._table)

    def send(self, sender: int, packet: bytes) -> None:
        """The packet of one of the stations, and what the borrower does with it."""
        if not self.ask() or (sender == 0 and not self._put(packet)):
            self._ends[sender].send(packet)
        elif sender != 0:
            self._ends[sender].send(packet)
            size = loan_kernel.receive(self._table, self._room, _PATIENCE_MS)
            if size > 0:
                self.heard.append(self._room[: size // 8].tobytes())
            self.passed += size > 0

    def _put(self, packet: bytes) -> bool:
        done = loan_kernel.put(self._table, np.array(list(packet), np.uint8), len(packet), self._room)
        self.passed += done
        return done

    def close(self) -> None:
        for each in self.loans:
            each.close()


def heard_in_turns(packets: Sequence[tuple[int, list[tuple[int, int, int, bytes]], bytes]], *, lent: bool) -> Any:
    """What each hears when one packet is over before the next one is sent; what the hub has counted; packets that went
    by without it."""
    with ExitStack() as resources:
        stations = Stations(resources, loaded=lent)
        borrower = resources.enter_context(closing(Borrower(stations)))
        stations.serve()
        for sender, records, rest in packets:
            borrower.send(sender, packet_of(records, rest))
            stations.await_taken()
        borrower.close()
        stations.say_no_more()
        own, *others = stations.left()
        heard = [[packet[protocol.HEADER.size :] for packet in each] for each in (borrower.heard + own, *others)]
        return list(map(b"".join, heard)), stations.counted(), borrower.passed


def is_plain(records: Sequence[tuple[int, int, int, bytes]], rest: bytes) -> bool:
    """Whether all of a packet are frames that could be on a wire."""
    sizes = all(size <= 8 and flags != ERROR_FLAG for _, flags, size, _ in records)
    return sizes and bool(records) and not rest and all(n < 0x800 or f == EXTENDED_FLAG for n, f, _, _ in records)


@given(PACKETS)
@settings(max_examples=30, deadline=None)
def test_a_station_that_has_the_wire_does_with_packets_what_the_hub_does(packets):
    heard, counted, passed = heard_in_turns(2 * packets, lent=True)
    assert (heard, counted) == heard_in_turns(2 * packets, lent=False)[:2]
    assert passed >= sum(is_plain(records, rest) for _, records, rest in packets)  # once they are known


def test_who_does_not_read_loses_nothing_of_what_a_station_with_the_wire_passes_on():
    """Its socket is full in the middle of what it hears: the rest is the hub's."""
    frames = 100
    with ExitStack() as resources:
        stations = Stations(resources, loaded=True)
        stations.clients[3].connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 14)
        borrower = resources.enter_context(closing(Borrower(stations)))
        stations.serve()
        reader = stations.ends[3]
        came: list[tuple[int, int, int]] = []

        def read_until(count: int) -> None:
            while len(came) < count:
                packet = reader.recv(protocol.PACKET_BYTES)
                assert protocol.HEADER.unpack_from(packet)[1] == 0
                ((can_id, _, _, data, time_ns),) = protocol.STAMPED_CAN_RECORD.iter_unpack(packet[8:])
                came.append((int.from_bytes(data, "little"), can_id, time_ns))

        for at in range(20):
            records = [(number, 0, 8, at.to_bytes(8, "little")) for number in range(frames)]
            borrower.send(at % 2, packet_of(records))
            if at < 2:
                read_until((at + 1) * frames)  # known from now on
        read_until(20 * frames)
        assert borrower.passed
        assert [(at, number) for at, number, _ in came] == [(at, n) for at in range(20) for n in range(frames)]
        assert all(before[2] < behind[2] for before, behind in pairwise(came))
        borrower.close()
        stations.say_no_more()
        stations.left()
        stations.counted()


def test_who_comes_goes_or_asks_gets_the_wire_for_the_hub_again():
    packet = packet_of([(number, 0, 8, bytes(8)) for number in range(4)])
    with ExitStack() as resources:
        stations = Stations(resources, loaded=True)
        borrower = resources.enter_context(closing(Borrower(stations)))
        stations.serve()

        def passes_by() -> bool:
            """Whether a packet does, once its frames are known."""
            borrower.send(0, packet)
            stations.ask(request="statistics")[0].close()
            before = borrower.passed
            borrower.send(0, packet)
            return borrower.passed == before + 1 and loan_kernel.has(borrower._table)

        assert passes_by()
        connection, counted = stations.ask(request="statistics")
        connection.close()
        assert (counted["frames"], counted["stations"]) == (8, 4)
        assert not loan_kernel.has(borrower._table)
        assert passes_by()
        newcomer, joined = stations.ask(request="join")
        assert not loan_kernel.has(borrower._table)
        assert passes_by()
        assert sum(len(newcomer.recv(protocol.PACKET_BYTES)) for _ in range(2)) == 2 * (8 + 4 * 24)
        connection, _ = stations.ask(request="set_filters", station=joined["station"], filters=[[2, 0x7FF]])
        connection.close()
        assert not loan_kernel.has(borrower._table)
        assert passes_by()
        assert sum(len(newcomer.recv(protocol.PACKET_BYTES)) for _ in range(2)) == 2 * (8 + 24)
        newcomer.close()
        stations.ask(request="statistics")[0].close()
        assert passes_by()
        stations.ask(request="set_errors", lost=1.0)[0].close()
        borrower.send(0, packet)
        assert not borrower.ask()  # what happens to frames the hub decides
        borrower.close()
        stations.say_no_more()
        stations.left()
        stations.counted()


# -- processes that end or stand still ---------------------------------------------------------------------------------

NOISE = packet_of([(0x300 + at, 0, 8, bytes((at,)) * 8) for at in range(8)])


def floods_with_the_wire(bus: BusAddress, *, reads: bool) -> int:
    """A process of its own that asks for the wire, sends over it, and hears what comes, until it is killed."""
    pid = os.fork()
    if pid == 0:
        try:
            link = open_link(bus)
            assert isinstance(link, EmbeddedLink)
            room, noise, table = np.zeros(_ROOM, np.int64), np.array(list(NOISE), np.uint8), loan.NO_WIRE
            while True:
                if not loan_kernel.put(table, noise, len(NOISE), room):
                    link.send_records(NOISE[protocol.HEADER.size :])
                    link.receive(0.0)
                    lent, _ = link.borrow()
                    table = loan.NO_WIRE if lent is None else lent.table
                elif reads:
                    loan_kernel.receive(table, room, 1)
        finally:
            os._exit(1)
    return pid


@pytest.mark.parametrize(("how", "seed", "tries"), [("killed", 1, 20), ("stopped", 2, 10), *slow(("killed", 3, 1000))])
def test_a_station_with_the_wire_that_ends_or_stands_still_leaves_nobody_hanging(runtime, how, seed, tries):
    drawn = random.Random(seed)
    bus = BusAddress(channel=f"l{uuid.uuid4().hex[:10]}", timing="virtual")
    cast(Any, loan_kernel.put).compile((TABLE, OCTETS, COUNT, INDICES))  # once, before there are others
    cast(Any, loan_kernel.receive).compile((TABLE, INDICES, COUNT))
    with closing(open_link(bus)) as one, closing(open_link(bus)) as other:
        loads_its_forwarder(runtime, one, other)
        other.set_filters([(0x100, 0x7FF)])
        one.set_filters([])
        had = 0
        for number in range(tries):
            pid = floods_with_the_wire(bus, reads=drawn.random() < 0.5)
            time.sleep(drawn.uniform(0.0, 0.05))
            before = hub_client.statistics(bus.channel).frames
            time.sleep(drawn.uniform(0.0, 0.02))
            if how == "stopped":
                os.kill(pid, signal.SIGSTOP)
                assert passes(one, other, number)
            had += hub_client.statistics(bus.channel).frames > before
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            assert passes(one, other, number + tries)
        assert had
        assert runtime.eventually(lambda: hub_client.statistics(bus.channel).stations == 2)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_hub_that_ends_while_the_wire_is_lent_is_a_lost_bus_for_all(runtime, number):
    bus = BusAddress(timing="virtual")
    with closing(open_link(bus)) as one, closing(open_link(bus)) as other:
        pid = loads_its_forwarder(runtime, one, other)
        assert isinstance(one, EmbeddedLink)
        lent = None
        while lent is None:
            lent, _ = one.borrow()
        os.kill(pid, number)
        with pytest.raises(BusError, match="hilbench0"):
            one.receive(20.0)
        with pytest.raises(BusError, match="hilbench0"):
            other.receive(20.0)
    assert runtime.eventually(lambda: not runtime.hubs())
    with closing(open_link(bus)):  # takes the place of one that was killed
        pass
