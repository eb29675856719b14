"""What the hub does with packets of known frames on an undisturbed wire where time is real, compiled.

As `forwarding_kernel`, of whose functions it is made; but here frames wait in the stations' queues, and are over when
the clock says so. What waits when the loop ends is for the hub, as is all else. What it calls beside them are
clock_gettime(2), ppoll(2) and prctl(2).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hilbench.c_library import CLOCK_MONOTONIC, POLLIN, PR_SET_TIMERSLACK, clock_gettime, ppoll, prctl
from hilbench.can import forwarding_kernel as wire
from hilbench.can import protocol
from hilbench.can.compiled_wire import bits_on_wire
from hilbench.can.forwarding_kernel import Octets, Row, Table, Words
from hilbench.compiled import COUNT, INDICES, TABLE, compiled, entry_point, number_of_sources, viewed

_OCTET, _WORD = np.dtype(np.uint8), np.dtype(np.uint32)

#: Frames that a station's queue has room for; while there is none for one more packet the queue is for the hub.
ROOM: Final = 512
#: Columns of a frame in a queue: a `protocol.CAN_RECORD`, bits, what these take, when it came, its priority, who hears
#: it (a bit each).
RECORD, DATA, BITS, DURATION_NS, READY_NS, PRIORITY, HEARD_BY, OF_QUEUED = range(8)
#: Columns of a queue: where its first frame is, and how many there are.
FIRST, COUNT_OF, OF_QUEUE = range(3)
#: Places in `clock`. Of the hub: what is to be added to the monotonic clock. Of both: who is on the wire (-1: nobody),
#: and until when. Of the loop: room for a timespec and a struct pollfd.
OFFSET_NS, SENDER, END_NS, TIME, POLLED, OF_CLOCK = 0, 1, 2, 3, 5, 6

_HEADER_BYTES, _RECORD_BYTES = protocol.HEADER.size, protocol.CAN_RECORD.size
_RECORD_WORDS = _RECORD_BYTES // 8
_MAX_RECORDS, _MAX_CARRIED = protocol.MAX_RECORDS, wire.MAX_CARRIED
_SECOND_NS = 1_000_000_000
_FOREVER = 1 << 62
_NO_DESCRIPTOR = 1 << 30

Forward = Callable[[int, Row, Row, Row, Row, Table, Table, Words, Table, Table, Table, Table, Table, Table, Row], None]


@compiled
def _now_ns(clock: Row) -> int:
    """`Hub._now_ns`."""
    clock_gettime(CLOCK_MONOTONIC, clock[TIME:].ctypes.data)
    return int(clock[TIME] * _SECOND_NS + clock[TIME + 1] + clock[OFFSET_NS])


@compiled
def queue(
    state: Row,
    known: Table,
    packets: Table,
    count: int,
    rows: Table,
    received: Table,
    octets: Octets,
    queues: Table,
    queued: Table,
    now_ns: int,
) -> bool:
    """`Hub._take_frames` of these packets; whether the queues have room for more."""
    has_room = True
    for at in range(count):
        station = packets[at, wire.STATION]
        of_queue = queues[station]
        for frame in range(packets[at, wire.FRAMES]):
            of_frame = known[rows[at, frame]]
            slot = queued[station * ROOM + (of_queue[FIRST] + of_queue[COUNT_OF]) % ROOM]
            first = _HEADER_BYTES + frame * _RECORD_BYTES
            data = octets[at, first + 8 :]
            bits = bits_on_wire(
                of_frame[wire.CRC], of_frame[wire.STUFFING], of_frame[wire.BITS], data, of_frame[wire.DATA_BYTES]
            )
            slot[RECORD] = received[at, 1 + frame * _RECORD_WORDS]
            slot[DATA] = received[at, 2 + frame * _RECORD_WORDS]
            slot[BITS], slot[DURATION_NS] = bits, bits * _SECOND_NS // state[wire.BITRATE]
            slot[READY_NS], slot[PRIORITY] = now_ns, of_frame[wire.PRIORITY]
            slot[HEARD_BY] = of_frame[wire.HEARD_BY] & ~(1 << station)
            of_queue[COUNT_OF] += 1
        has_room = has_room and of_queue[COUNT_OF] + _MAX_RECORDS <= ROOM
    return has_room


@compiled
def _arbitrate(state: Row, clock: Row, queues: Table, queued: Table, until_ns: int) -> bool:
    """`Medium._arbitrate`."""
    start_ns = _FOREVER
    for station in range(len(queues)):
        if queues[station, COUNT_OF] > 0:
            start_ns = min(start_ns, queued[station * ROOM + queues[station, FIRST], READY_NS])
    start_ns = max(start_ns, state[wire.FREE_NS])
    if start_ns > until_ns:
        return False
    winner, best = -1, 0
    for station in range(len(queues)):
        if queues[station, COUNT_OF] == 0:
            continue
        head = queued[station * ROOM + queues[station, FIRST]]
        if head[READY_NS] <= start_ns and (winner < 0 or head[PRIORITY] < best):
            winner, best = station, head[PRIORITY]
    head = queued[winner * ROOM + queues[winner, FIRST]]
    clock[SENDER], clock[END_NS] = winner, start_ns + head[DURATION_NS]
    return True


@compiled
def carry(state: Row, clock: Row, queues: Table, queued: Table, until_ns: int, carried: Table) -> int:
    """`Medium.run`, as far as there is room in `carried`; the number of frames."""
    over = 0
    while over < _MAX_CARRIED:
        if clock[SENDER] < 0 and not _arbitrate(state, clock, queues, queued, until_ns):
            return over
        if clock[END_NS] > until_ns:
            return over
        sender = clock[SENDER]
        frame, found = queued[sender * ROOM + queues[sender, FIRST]], carried[over]
        queues[sender, FIRST] = (queues[sender, FIRST] + 1) % ROOM
        queues[sender, COUNT_OF] -= 1
        clock[SENDER] = -1
        state[wire.FREE_NS] = clock[END_NS]
        state[wire.CARRIED_FRAMES] += 1
        state[wire.CARRIED_BITS] += frame[BITS]
        found[wire.STAMPED], found[wire.DATA], found[wire.TIME_NS] = frame[RECORD], frame[DATA], clock[END_NS]
        found[wire.TO] = frame[HEARD_BY]
        over += 1
    return over


@compiled
def _wait(epoll: int, clock: Row, now_ns: int) -> int:
    """Until something happens, or the frame on the wire is over; as ppoll(2)."""
    clock[POLLED] = epoll | POLLIN << 32
    timeout = 0
    if clock[SENDER] >= 0:
        left_ns = max(0, clock[END_NS] - now_ns)
        clock[TIME], clock[TIME + 1] = left_ns // _SECOND_NS, left_ns % _SECOND_NS
        timeout = clock[TIME:].ctypes.data
    return int(ppoll(clock[POLLED:].ctypes.data, 1, timeout, 0))


def _entry_point(sources: int) -> Forward:
    """For Python; `sources` as in `compiled.number_of_sources`."""

    @entry_point(
        COUNT, INDICES, INDICES, INDICES, INDICES, TABLE, TABLE, wire.WORDS, TABLE, TABLE, TABLE, TABLE, TABLE, TABLE,
        INDICES,
    )  # fmt: skip
    def forward(
        epoll: int,
        state: Row,
        clock: Row,
        descriptors: Row,
        of_descriptors: Row,
        stations: Table,
        known: Table,
        events: Words,
        received: Table,
        packets: Table,
        rows: Table,
        carried: Table,
        queues: Table,
        queued: Table,
        out: Row,
    ) -> None:
        octets, words = viewed(received, _OCTET), viewed(received, _WORD)
        state[wire.PACKETS_LEFT] = state[wire.FRAMES_LEFT] = 0
        prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)  # else the kernel may wake it 50 µs late to save energy
        while sources >= 0:
            now_ns = _now_ns(clock)
            over = carry(state, clock, queues, queued, now_ns, carried)
            if not wire.hand_out(state, descriptors, stations, carried, over, out):
                state[wire.FRAMES_LEFT] = over
                return
            happened = 0 if over == _MAX_CARRIED else _wait(epoll, clock, _now_ns(clock) if over > 0 else now_ns)
            if happened == 0:
                continue
            count = wire.ready(epoll, of_descriptors, events, 0) if happened > 0 else -1
            if count <= 0:
                return
            if not wire.take_in(count, of_descriptors, stations, known, events, received, packets, rows, octets, words):
                state[wire.PACKETS_LEFT] = count
                return
            now_ns = _now_ns(clock)
            if not queue(state, known, packets, count, rows, received, octets, queues, queued, now_ns):
                return

    return forward


#: forward(epoll, state, clock, descriptors of the stations, stations by descriptor (-1: none), stations, known frames,
#: room for events, packets, their columns, rows of their frames, what is carried, queues, what is in them (`ROOM` rows
#: of each), and a packet): until something happens that is not packets of known frames, see `forwarding_kernel.state`.
forward = _entry_point(number_of_sources(__file__, *wire.SOURCES, wire.__file__))


def warm_up() -> None:
    """Compile, or load from the cache, before anybody waits for a frame."""
    row, table = np.zeros(wire.OF_STATE, np.int64), np.zeros((0, 0), np.int64)
    received, clock = np.zeros((0, wire.PACKET_WORDS), np.int64), np.zeros(OF_CLOCK, np.int64)
    clock[SENDER] = -1
    words = np.zeros(0, np.uint32)
    forward(_NO_DESCRIPTOR, row, clock, row, row, table, table, words, received, table, table, table, table, table, row)
