"""Forwarding without the interpreter: tables for `forwarding_kernel`, made from the hub's objects.

Known frames and their receivers are learnt from those that the hub has passed on itself, and forgotten when
a station joins or leaves or changes its filters.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from hilbench.can import forwarding_kernel as kernel
from hilbench.can import protocol, wire
from hilbench.can.arbitration import priority
from hilbench.can.frame import REMOTE_FLAG, is_classical
from hilbench.can.medium import Medium

_STAMPED_WORDS = protocol.STAMPED_CAN_RECORD.size // 8


#: A station on the wire, as frames are sent and received: descriptor, records in one packet to it, frames
#: dropped so far, true if it receives its own.
Place = tuple[int, int, int, bool]


class Left(NamedTuple):
    """Work left for the hub."""

    #: Sender and packet: not sent yet; None: none came after all.
    packets: list[tuple[int, bytes | None]]
    #: Stations, and the records for each that were held back because the socket of one before it was full.
    undelivered: list[tuple[int, list[bytes]]]


class Forwarder:
    """Passes on packets of known frames; `epoll` waits for the stations, and for all else that can happen."""

    #: More are forwarded by the hub itself.
    MAX_STATIONS = kernel.MAX_STATIONS

    def __init__(self, epoll: int) -> None:
        self._epoll = epoll
        self._descriptors = self._of_descriptors = np.zeros(0, np.int64)
        self._events = np.zeros((kernel.MAX_READY + 1) * kernel.EVENT_WORDS, np.uint32)
        self._out = np.zeros(kernel.PACKET_WORDS, np.int64)
        self._tables, self._known_count = kernel.Tables(), 0
        self._places: list[Place] = []
        kernel.warm_up()

    def forward(self, medium: Medium, places: list[Place]) -> Left:
        """Serve the stations at these places, in the order in which they joined, while all that happens is packets of
        known frames; the wire is `undisturbed`."""
        self._begin(medium, places)
        tables, count = self._tables, len(places)
        kernel.forward(
            self._epoll,
            tables.state,
            self._descriptors,
            self._of_descriptors,
            tables.stations[:count],
            tables.known,
            self._events,
            tables.received,
            tables.packets,
            tables.rows,
            tables.carried,
            self._out,
        )
        return self._end(medium)

    def _begin(self, medium: Medium, places: list[Place]) -> None:
        if places != self._places:
            self._take(places)
        state = self._tables.state
        state[kernel.BITRATE], state[kernel.FREE_NS] = medium.bitrate, medium.free_ns
        state[kernel.CARRIED_FRAMES] = state[kernel.CARRIED_BITS] = 0

    def _end(self, medium: Medium) -> Left:
        state = self._tables.state
        frames, bits, free_ns = state[[kernel.CARRIED_FRAMES, kernel.CARRIED_BITS, kernel.FREE_NS]].tolist()
        medium.account(frames, bits, free_ns - medium.free_ns)
        return Left([self._packet(at) for at in range(state[kernel.PACKETS_LEFT])], list(self._undelivered()))

    def _packet(self, at: int) -> tuple[int, bytes | None]:
        station, size = self._tables.packets[at, [kernel.STATION, kernel.SIZE]].tolist()
        return station, None if size < 0 else self._tables.received[at].tobytes()[:size]

    def _take(self, places: list[Place]) -> None:
        self._places = places
        self._descriptors = np.array([descriptor for descriptor, *_ in places], np.int64)
        self._of_descriptors = np.full(max(self._descriptors, default=0) + 1, -1)
        self._of_descriptors[self._descriptors] = range(len(places))
        rows = self._tables.stations[: len(places)]
        for row, (_, limit, dropped, receive_own) in zip(rows, places, strict=True):
            header = protocol.HEADER.pack(protocol.KIND_CLASSICAL, dropped & 0xFFFFFFFF)
            row[kernel.LIMIT], row[kernel.OWN] = limit, receive_own
            row[kernel.HEADER] = int.from_bytes(header, sys.byteorder)

    def _undelivered(self) -> Iterator[tuple[int, list[bytes]]]:
        tables = self._tables
        carried = tables.carried[: tables.state[kernel.FRAMES_LEFT]]
        receiver, since = tables.state[[kernel.RECEIVER, kernel.RECEIVED]].tolist()
        if not len(carried):
            return
        for station in range(receiver, len(self._places)):
            yield station, [row[:_STAMPED_WORDS].tobytes() for row in carried[since:] if row[kernel.TO] >> station & 1]
            since = 0

    def learn(self, packet: bytes, received_by: Callable[[int], int]) -> None:
        """Learn the frames of a packet; `received_by`: stations that receive an identifier, a bit
        each."""
        body = memoryview(packet)[protocol.HEADER.size :]
        if len(packet) < protocol.HEADER.size or packet[0] != protocol.KIND_CLASSICAL:
            return
        if len(body) % protocol.CAN_RECORD.size == 0:
            for can_id, length, _, _ in protocol.CAN_RECORD.iter_unpack(body):
                if is_classical(can_id, length):
                    self._know(can_id, length, received_by(can_id))

    def _know(self, can_id: int, length: int, received_by: int) -> None:
        if 2 * self._known_count >= kernel.KNOWN_ROWS:
            self.forget()
        key = kernel.key_of(can_id, length)
        row = kernel.first_row(key)
        while self._tables.known[row, kernel.KEY] not in (0, key + 1):
            row = (row + 1) % kernel.KNOWN_ROWS
        self._known_count += int(self._tables.known[row, kernel.KEY] == 0)
        known = self._tables.known[row]
        known[kernel.KEY] = key + 1
        known[[kernel.CRC, kernel.STUFFING, kernel.BITS]] = wire.header(can_id, length)
        known[kernel.DATA_BYTES] = 0 if can_id & REMOTE_FLAG else length
        known[kernel.PRIORITY], known[kernel.RECEIVED_BY] = priority(can_id), received_by

    def forget(self) -> None:
        """Forget all frames: a station has joined or left, or changed its filters."""
        self._tables.known[:], self._known_count = 0, 0
