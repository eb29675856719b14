"""Compiled part of the hub: packets of known frames on a quiet wire with virtual time.

One loop waits for stations to send, lets the wire carry their frames, and sends them to the receivers, until
anything else happens: that is for `hub`, which is the reference. Each function names its counterpart. It calls
epoll_wait(2), recv(2) and send(2) of the C library of the process.
"""

from __future__ import annotations

import platform
from typing import Final

import numpy as np
from numba import types
from numpy.typing import NDArray

from hilbench.c_library import MSG_DONTWAIT, MSG_NOSIGNAL, epoll_wait, recv, send
from hilbench.can import protocol
from hilbench.can.compiled_wire import bits_on_wire
from hilbench.compiled import COUNT, INDICES, TABLE, compiled, entry_point, viewed

_OCTET, _WORD = np.dtype(np.uint8), np.dtype(np.uint32)

#: Receivers of a frame are the bits of a number.
MAX_STATIONS: Final = 62
#: If more stations have sent at once, it is for the hub.
MAX_READY: Final = 16
#: Rows of `known`; a power of two, of which a half is used at most.
KNOWN_ROWS: Final = 8192
_LAST_ROW = KNOWN_ROWS - 1

#: Columns of a station: records in one packet to it, the header of the next one, 1 if it receives its own frames.
LIMIT, HEADER, OWN, OF_STATION = range(4)
#: Columns of a known frame: its key, `key_of` plus 1 (0: empty row); `wire.header`, data bytes
#: on the wire, `arbitration.priority`, stations that receive it (a bit each).
KEY, CRC, STUFFING, BITS, DATA_BYTES, PRIORITY, RECEIVED_BY, OF_FRAME = range(8)
#: Columns of a received packet: its station, size in bytes (-1: none came after all), its frames, the next of them.
STATION, SIZE, FRAMES, NEXT, OF_PACKET = range(5)
#: Columns of a frame that was carried: a `protocol.STAMPED_CAN_RECORD`, its receivers.
STAMPED, DATA, TIME_NS, TO, OF_CARRIED = range(5)
#: Places in `state`. Of the hub: bit/s. Of both: bus time. Of the loop: frames carried, packets
#: left for the hub, frames left (all are carried), the first station without all of its frames, and from
#: which of them on.
(
    BITRATE,
    FREE_NS,
    CARRIED_FRAMES,
    CARRIED_BITS,
    PACKETS_LEFT,
    FRAMES_LEFT,
    RECEIVER,
    RECEIVED,
    OF_STATE,
) = range(9)

PACKET_WORDS: Final = protocol.PACKET_BYTES // 8
# A record in words of 8 bytes, words of 4, and bytes; a packet's header is one word of 8.
_RECORD, _RECORD_4, _RECORD_1 = 2, 4, protocol.CAN_RECORD.size
_STAMPED_WORDS = protocol.STAMPED_CAN_RECORD.size // 8
_HEADER_BYTES = protocol.HEADER.size
_MAX_RECORDS, _CLASSICAL, _PACKET_BYTES = protocol.MAX_RECORDS, protocol.KIND_CLASSICAL, protocol.PACKET_BYTES
MAX_CARRIED: Final = MAX_READY * _MAX_RECORDS
# struct epoll_event in words of 4 bytes, and where its descriptor is (<linux/eventpoll.h>: packed on one machine).
EVENT_WORDS, _EVENT_DESCRIPTOR = (3, 1) if platform.machine() == "x86_64" else (4, 2)
_EPOLLIN = 1
_SECOND_NS = 1_000_000_000

Table = NDArray[np.int64]
Row = NDArray[np.int64]
Octets = NDArray[np.uint8]
Words = NDArray[np.uint32]
#: Type of an array of uint32, for entry points.
WORDS = types.Array(types.uint32, 1, "C")


class Tables:
    """Arrays of the loop, all 0: known stations and frames, and room for packets in and out."""

    def __init__(self) -> None:
        self.state = np.zeros(OF_STATE, np.int64)
        self.stations = np.zeros((MAX_STATIONS, OF_STATION), np.int64)
        self.known = np.zeros((KNOWN_ROWS, OF_FRAME), np.int64)
        self.received = np.zeros((MAX_READY, PACKET_WORDS), np.int64)
        self.packets = np.zeros((MAX_READY, OF_PACKET), np.int64)
        self.rows = np.zeros((MAX_READY, protocol.MAX_RECORDS), np.int64)
        self.carried = np.zeros((MAX_CARRIED, OF_CARRIED), np.int64)


def key_of(can_id: int, length: int) -> int:
    """Key of frames that differ in their data only."""
    return can_id << 4 | length


def first_row(key: int) -> int:
    """Row of `known` where the search for a key begins."""
    return (key ^ key >> 7 ^ key >> 19) & _LAST_ROW


_key_of, _first_row = compiled(key_of), compiled(first_row)


@compiled
def known_frames(octets: Octets, words: Words, size: int, known: Table, rows: Row) -> int:
    """Number of frames in a packet, and their `rows` of the known ones; 0: a frame is not known."""
    count = (size - _HEADER_BYTES) // _RECORD_1
    if octets[0] != _CLASSICAL or (size - _HEADER_BYTES) % _RECORD_1 != 0 or not 0 < count <= _MAX_RECORDS:
        return 0
    for frame in range(count):
        length = int(octets[_HEADER_BYTES + frame * _RECORD_1 + 4])
        if length > 8:
            return 0
        key = _key_of(int(words[2 + frame * _RECORD_4]), length)
        row = _first_row(key)
        while known[row, KEY] != key + 1:
            if known[row, KEY] == 0:
                return 0
            row = (row + 1) & _LAST_ROW
        rows[frame] = row
    return int(count)


@compiled
def ready(epoll: int, of_descriptors: Row, events: Words) -> int:
    """Wait; how many stations have sent something. 0: something else has happened."""
    count = epoll_wait(epoll, events.ctypes.data, MAX_READY + 1, -1)
    if count <= 0 or count > MAX_READY:
        return 0
    for at in range(count):
        descriptor = events[at * EVENT_WORDS + _EVENT_DESCRIPTOR]
        if descriptor >= len(of_descriptors) or of_descriptors[descriptor] < 0 or events[at * EVENT_WORDS] != _EPOLLIN:
            return 0
    return int(count)


@compiled
def take_in(
    count: int,
    of_descriptors: Row,
    stations: Table,
    known: Table,
    events: Words,
    received: Table,
    packets: Table,
    rows: Table,
    octets: Octets,
    words: Words,
) -> bool:
    """`Hub._attend` of so many stations that have sent; true if all packets are of known frames."""
    is_regular = True
    for at in range(count):
        descriptor = events[at * EVENT_WORDS + _EVENT_DESCRIPTOR]
        packet = packets[at]
        packet[STATION], packet[NEXT] = of_descriptors[descriptor], 0
        packet[SIZE] = recv(descriptor, received.ctypes.data + at * _PACKET_BYTES, _PACKET_BYTES, MSG_DONTWAIT)
        packet[FRAMES] = 0
        if packet[SIZE] > _HEADER_BYTES and stations[packet[STATION], OWN] == 0:
            packet[FRAMES] = known_frames(octets[at], words[at], packet[SIZE], known, rows[at])
        is_regular = is_regular and packet[FRAMES] > 0
    return is_regular


@compiled
def carry(
    state: Row, known: Table, packets: Table, count: int, rows: Table, received: Table, octets: Octets, carried: Table
) -> int:
    """`Medium.run(FOREVER)` with these packets in the queues of an undisturbed wire; the number of frames."""
    over = 0
    while True:
        winner, row = -1, 0
        for at in range(count):
            if packets[at, NEXT] == packets[at, FRAMES]:
                continue
            head = rows[at, packets[at, NEXT]]
            before = known[head, PRIORITY] - known[row, PRIORITY]
            if winner < 0 or before < 0 or (before == 0 and packets[at, STATION] < packets[winner, STATION]):
                winner, row = at, head
        if winner < 0:
            return over
        frame = packets[winner, NEXT]
        packets[winner, NEXT] = frame + 1
        of_frame, found = known[row], carried[over]
        data = octets[winner, _HEADER_BYTES + frame * _RECORD_1 + 8 :]
        bits = bits_on_wire(of_frame[CRC], of_frame[STUFFING], of_frame[BITS], data, of_frame[DATA_BYTES])
        state[FREE_NS] += bits * _SECOND_NS // state[BITRATE]
        state[CARRIED_FRAMES] += 1
        state[CARRIED_BITS] += bits
        found[STAMPED], found[DATA] = received[winner, 1 + frame * _RECORD], received[winner, 2 + frame * _RECORD]
        found[TIME_NS] = state[FREE_NS]
        found[TO] = of_frame[RECEIVED_BY] & ~(1 << packets[winner, STATION])
        over += 1


@compiled
def hand_out(state: Row, descriptors: Row, stations: Table, carried: Table, count: int, out: Row) -> bool:
    """Send frames to all receivers (`Hub._hand_out`). False if a socket was full; RECEIVER, RECEIVED: resume there."""
    for receiver in range(len(stations)):
        station, mask, size = stations[receiver], 1 << receiver, 0
        out[0] = station[HEADER]
        for at in range(count):
            if carried[at, TO] & mask != 0:
                if size == 0:
                    state[RECEIVER], state[RECEIVED] = receiver, at
                out[1 + size * _STAMPED_WORDS] = carried[at, STAMPED]
                out[2 + size * _STAMPED_WORDS] = carried[at, DATA]
                out[3 + size * _STAMPED_WORDS] = carried[at, TIME_NS]
                size += 1
            if size == station[LIMIT] or (size > 0 and at == count - 1):
                length = 8 * (1 + size * _STAMPED_WORDS)
                if send(descriptors[receiver], out.ctypes.data, length, MSG_DONTWAIT | MSG_NOSIGNAL) != length:
                    return False
                size = 0
    return True


#: forward(epoll, state, descriptors of the stations, stations by descriptor (-1: none), stations, known frames, room
#: for events, packets, their columns, rows of their frames, what is carried, and a packet): until something happens
#: that is not packets of known frames, see `state`.
@entry_point(COUNT, INDICES, INDICES, INDICES, TABLE, TABLE, WORDS, TABLE, TABLE, TABLE, TABLE, INDICES)
def forward(
    epoll: int,
    state: Row,
    descriptors: Row,
    of_descriptors: Row,
    stations: Table,
    known: Table,
    events: Words,
    received: Table,
    packets: Table,
    rows: Table,
    carried: Table,
    out: Row,
) -> None:
    octets, words = viewed(received, _OCTET), viewed(received, _WORD)
    state[PACKETS_LEFT] = state[FRAMES_LEFT] = 0
    while True:
        count = ready(epoll, of_descriptors, events)
        if count == 0:
            return
        if not take_in(count, of_descriptors, stations, known, events, received, packets, rows, octets, words):
            state[PACKETS_LEFT] = count
            return
        over = carry(state, known, packets, count, rows, received, octets, carried)
        if not hand_out(state, descriptors, stations, carried, over, out):
            state[FRAMES_LEFT] = over
            return


def warm_up() -> None:
    """Compile, or load from the cache, before a frame has to wait for it."""
    row, table, received = (
        np.zeros(OF_STATE, np.int64),
        np.zeros((0, 0), np.int64),
        np.zeros((0, PACKET_WORDS), np.int64),
    )
    forward(-1, row, row, row, table, table, np.zeros(0, np.uint32), received, table, table, table, row)
