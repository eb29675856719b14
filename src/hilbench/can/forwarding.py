"""Forwarding without the interpreter: a compiled loop on tables, made from the hub's objects.

Known frames and their receivers are learnt from those that the hub has passed on itself, and forgotten when
a station joins or leaves or changes its filters. One loop waits for stations to send, lets the quiet wire carry their
frames, and sends them to the receivers, until anything else happens: that is for `hub`, which is the reference. The
loop calls epoll_wait(2), recv(2) and send(2) of the C library of the process.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.c_library import MSG_DONTWAIT, MSG_NOSIGNAL, epoll_wait, recv, send
from hilbench.can import protocol, wire
from hilbench.can.compiled_wire import OCTET, RECORD, RECORD_BYTES, STAMPED, STAMPED_BYTES, bits_on_wire
from hilbench.can.medium import Medium
from hilbench.compiled import (
    COUNT,
    TABLE,
    Wholes,
    arrays_in,
    entry_point,
    load,
    merged,
    record_type,
    records,
    table_of,
    viewed,
)

#: Receivers of a frame are the bits of a number.
_MOST_STATIONS: Final = 62
#: If more stations have sent at once, it is for the hub.
MAX_READY: Final = 16
#: Lengths of data frames with an identifier of 11 bits, which are those that can be known.
LENGTHS, IDENTIFIERS = 9, 1 << 11

#: A station: its descriptor, records in one packet to it, the header of the next one, 1 if it receives its own frames.
STATION = record_type("descriptor", "limit", "header", "own", of=np.int64)
#: A known frame, by identifier and length: `wire.header` (no bits: it is not known), stations that receive it.
KNOWN = record_type("crc", "stuffing", "bits", "received_by", of=np.int64)
#: A received packet: its station, size in bytes (-1: none came after all), its frames, the next of them.
PACKET = record_type("station", "size", "frames", "next", of=np.int64)
#: Frames that were carried, in the place of the stamp with their receivers.
CARRIED = np.dtype([*STAMPED.descr, ("receivers", "i8")])
#: Of the hub: bit/s. Of both: bus time. Of the loop: frames carried and their bits, packets left for the hub, frames
#: left (all are carried), the first station without all of its frames, and from which of them on.
STATE = record_type(
    *("bitrate", "free_ns", "frames", "bits", "packets_left", "frames_left", "receiver", "received"), of=np.int64
)

_HEADER_BYTES, _CLASSICAL, _PACKET_BYTES = protocol.HEADER.size, protocol.KIND_CLASSICAL, protocol.PACKET_BYTES
_MAX_RECORDS = protocol.MAX_RECORDS
# struct epoll_event in words of 4 bytes, and where its descriptor is (<linux/eventpoll.h>: packed on one machine).
_EVENT_WORDS, _EVENT_DESCRIPTOR = (3, 1) if platform.machine() == "x86_64" else (4, 2)
_WORD, _LONG_WORD = np.dtype(np.uint32), np.dtype(np.int64)
_EPOLLIN = 1
_SECOND_NS = 1_000_000_000


class Wire(NamedTuple):
    """Arrays of the loop: known stations and frames, and room for packets in and out."""

    state: Annotated[Any, STATE]
    known: Annotated[Any, records(KNOWN)]
    events: Annotated[Any, records(_WORD)]
    packets: Annotated[Any, records(PACKET)]
    received: Annotated[Any, records(OCTET, 2)]
    carried: Annotated[Any, records(CARRIED)]
    out: Annotated[Any, records(OCTET)]
    stations: Annotated[Any, records(STATION)]
    of_descriptors: Wholes  #: stations by descriptor; -1: none


def new_wire() -> Wire:
    """A wire without stations, on which no frame is known."""
    return Wire(
        np.zeros(1, STATE),
        np.zeros(IDENTIFIERS * LENGTHS, KNOWN),
        np.zeros((MAX_READY + 1) * _EVENT_WORDS, np.uint32),
        np.zeros(MAX_READY, PACKET),
        np.zeros((MAX_READY, _PACKET_BYTES), np.uint8),
        np.zeros(MAX_READY * _MAX_RECORDS, CARRIED),
        np.zeros(_PACKET_BYTES, np.uint8),
        np.zeros(0, STATION),
        np.zeros(0, np.int64),
    )


@merged
def _ready(wire: Wire, epoll: int) -> int:
    """Wait; how many stations have sent something. 0: something else has happened."""
    events, known = wire.events, len(wire.of_descriptors)
    count = epoll_wait(epoll, events.ctypes.data, MAX_READY + 1, -1)
    strange = count <= 0 or count > MAX_READY
    for at in range(0 if strange else count):
        descriptor = events[at * _EVENT_WORDS + _EVENT_DESCRIPTOR]
        if descriptor >= known or wire.of_descriptors[descriptor] < 0 or events[at * _EVENT_WORDS] != _EPOLLIN:
            strange = True
    return 0 if strange else int(count)


@merged
def _frames(wire: Wire, at: int) -> int:
    """Number of frames in a packet; 0: one is not known."""
    size, octets = wire.packets[at].size, wire.received[at]
    count = (size - _HEADER_BYTES) // RECORD_BYTES
    if octets[0] != _CLASSICAL or (size - _HEADER_BYTES) % RECORD_BYTES != 0 or count > _MAX_RECORDS:
        count = 0
    came, unknown = viewed(octets[_HEADER_BYTES:], RECORD), 0
    for k in range(count):
        frame = came[k]
        is_data = frame.can_id < IDENTIFIERS and frame.size < LENGTHS
        unknown += not is_data or wire.known[frame.can_id * LENGTHS + frame.size].bits == 0
    return 0 if unknown else int(count)


@merged
def _take(wire: Wire, count: int) -> bool:
    """`Hub._attend` of so many stations that have sent; true if all packets are of known frames."""
    irregular = 0
    for at in range(count):
        packet, descriptor = wire.packets[at], wire.events[at * _EVENT_WORDS + _EVENT_DESCRIPTOR]
        packet.station, packet.next, packet.frames = wire.of_descriptors[descriptor], 0, 0
        packet.size = recv(descriptor, wire.received.ctypes.data + at * _PACKET_BYTES, _PACKET_BYTES, MSG_DONTWAIT)
        if packet.size > _HEADER_BYTES and wire.stations[packet.station].own == 0:
            packet.frames = _frames(wire, at)
        irregular += packet.frames == 0
    return irregular == 0


@merged
def _carry(wire: Wire, count: int) -> int:
    """`Medium.run(FOREVER)` with these packets in the queues of an undisturbed wire; the number of frames."""
    state, packets, carried = wire.state, wire.packets, 0
    winner = 0
    while winner >= 0:
        winner, lowest = -1, 0
        for at in range(count):
            if packets[at].next == packets[at].frames:
                continue
            can_id = viewed(wire.received[at][_HEADER_BYTES:], RECORD)[packets[at].next].can_id
            before = winner < 0 or can_id < lowest
            if before or (can_id == lowest and packets[at].station < packets[winner].station):
                winner, lowest = at, can_id
        if winner >= 0:
            octets, number = wire.received[winner][_HEADER_BYTES:], packets[winner].next
            frame, found = viewed(octets, RECORD)[number], wire.carried[carried]
            known = wire.known[frame.can_id * LENGTHS + frame.size]
            data = octets[number * RECORD_BYTES + 8 :]
            bits = bits_on_wire(known.crc, known.stuffing, known.bits, data, frame.size)
            state.free_ns += bits * _SECOND_NS // state.bitrate
            state.frames += 1
            state.bits += bits
            found.can_id, found.size, found.flags, found.data = frame.can_id, frame.size, frame.flags, frame.data
            found.time_ns = state.free_ns
            found.receivers = known.received_by & ~(1 << packets[winner].station)
            packets[winner].next = number + 1
            carried += 1
    return carried


@merged
def _hand_out(wire: Wire, count: int) -> bool:
    """Send frames to all receivers (`Hub._hand_out`). False if a socket was full: resume at `receiver`, `received`."""
    state, out, carried = wire.state, wire.out, wire.carried
    packed, header = viewed(out[_HEADER_BYTES:], STAMPED), viewed(out, _LONG_WORD)
    for receiver in range(len(wire.stations)):
        station, mask, size = wire.stations[receiver], 1 << receiver, 0
        header[0] = station.header
        for at in range(count):
            frame = carried[at]
            if frame.receivers & mask != 0:
                if size == 0:
                    state.receiver, state.received = receiver, at
                record = packed[size]
                record.can_id, record.size, record.flags = frame.can_id, frame.size, frame.flags
                record.data, record.time_ns = frame.data, frame.time_ns
                size += 1
            if size == station.limit or (size > 0 and at == count - 1):
                length = _HEADER_BYTES + size * STAMPED_BYTES
                if send(station.descriptor, out.ctypes.data, length, MSG_DONTWAIT | MSG_NOSIGNAL) != length:
                    return False
                size = 0
    return True


#: forward(epoll, table of a `Wire`): until something happens that is not packets of known frames, see `STATE`.
@entry_point(COUNT, TABLE)
def forward(epoll: int, table: NDArray[np.int64]) -> None:
    wire = arrays_in(table, Wire)
    state = wire.state
    while True:
        count = _ready(wire, epoll)
        if count == 0:
            return
        if not _take(wire, count):
            state.packets_left = count
            return
        carried = _carry(wire, count)
        if not _hand_out(wire, carried):
            state.frames_left = carried
            return


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
    MAX_STATIONS: Final = _MOST_STATIONS

    def __init__(self, epoll: int) -> None:
        self._epoll, self._wire = epoll, new_wire()
        self._table = table_of(self._wire)
        self._places: list[Place] = []
        load(forward)

    def forward(self, medium: Medium, places: list[Place]) -> Left:
        """Serve the stations at these places, in the order in which they joined, while all that happens is packets of
        known frames; the wire is `undisturbed`."""
        if places != self._places:
            self._take(places)
        state = self._wire.state
        state[0] = 0
        state["bitrate"], state["free_ns"] = medium.bitrate, medium.free_ns
        forward(self._epoll, self._table)
        left = state[0]
        medium.account(int(left["frames"]), int(left["bits"]), int(left["free_ns"]) - medium.free_ns)
        return Left([self._packet(at) for at in range(left["packets_left"])], list(self._undelivered()))

    def _packet(self, at: int) -> tuple[int, bytes | None]:
        packet = self._wire.packets[at]
        size = int(packet["size"])
        return int(packet["station"]), None if size < 0 else self._wire.received[at].tobytes()[:size]

    def _take(self, places: list[Place]) -> None:
        self._places = places
        headers = (protocol.HEADER.pack(protocol.KIND_CLASSICAL, dropped & 0xFFFFFFFF) for _, _, dropped, _ in places)
        rows = [
            (descriptor, limit, int.from_bytes(header, sys.byteorder), own)
            for (descriptor, limit, _, own), header in zip(places, headers, strict=True)
        ]
        stations = np.array(rows, STATION)
        of_descriptors = np.full(max(stations["descriptor"], default=0) + 1, -1)
        of_descriptors[stations["descriptor"]] = range(len(places))
        self._wire = self._wire._replace(stations=stations, of_descriptors=of_descriptors)
        self._table = table_of(self._wire)

    def _undelivered(self) -> Iterator[tuple[int, list[bytes]]]:
        state = self._wire.state[0]
        carried, since = self._wire.carried[: state["frames_left"]], int(state["received"])
        for station in range(state["receiver"], len(self._places) if len(carried) else 0):
            yield (
                station,
                [row.tobytes()[:STAMPED_BYTES] for row in carried[since:] if row["receivers"] >> station & 1],
            )
            since = 0

    def learn(self, can_id: int, length: int, received_by: int) -> None:
        """Learn a frame; `received_by`: stations that receive it, a bit each."""
        if can_id < IDENTIFIERS:
            self._wire.known[can_id * LENGTHS + length] = (*wire.header(can_id, length), received_by)

    def forget(self) -> None:
        """Forget all frames: a station has joined or left, or changed its filters."""
        self._wire.known[:] = 0
