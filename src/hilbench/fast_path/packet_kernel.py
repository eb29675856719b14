"""Packets of the embedded bus without the interpreter: received, decoded, answered by `kernel.exchange`, sent; and
on the bench's side sent, their answers gathered and decoded.

Functions called of the C library are recv(2), send(2) and clock_gettime(2). An unexpected packet
stays in the buffer, for the interpreter.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.c_library import CLOCK_MONOTONIC, MSG_DONTWAIT, MSG_NOSIGNAL, clock_gettime, recv, send
from hilbench.can import protocol
from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, NmtState
from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    integers,
    table_of,
    viewed,
)
from hilbench.cycle_program import CONTINUE
from hilbench.fast_path import kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.kernel import Table
from hilbench.fast_path.layout import Bytes, Whole

#: Outcome for a packet: none has come; an unexpected one; it has the bench's heartbeat,
#: which is to be consumed before it is answered; answered; answered, but the bus did not take the answers.
NOTHING, OTHER, ALIVE, ANSWERED, UNSENT = range(5)
#: Where to begin: with the next packet; with that in the buffer; after its heartbeat, which was consumed.
RECEIVE, TAKEN, RECEIVED = range(3)
#: Places among the numbers. Of Python: the socket, addresses of both buffers and of room for a timespec, frames that
#: the bus has dropped, until when a packet is taken (ns of the monotonic clock), how long that in the buffer is. Of the
#: kernel: the same, when it was there, whose heartbeat (COB-ID) is in it, how long what is sent is; what was gathered:
#: frames, those that are no heartbeats, packets, where the last one ends.
(
    DESCRIPTOR,
    IN_AT,
    OUT_AT,
    TIME_AT,
    DROPPED,
    UNTIL_NS,
    LENGTH,
    NOW_NS,
    HEARTBEAT_OF,
    OUT_LENGTH,
    CAME,
    ANSWERS_CAME,
    PACKETS_CAME,
    IN_END,
    PLACES,
) = range(15)
#: Bus time is the hub's: the kernel's value here is not used.
BITRATE = 1_000_000
#: Columns of the expected frames, and of the checks in them: a value of these octets of a record, under a mask.
COB_ID, SIZE = range(2)
RECORD_OF, OFFSET, WIDTH, MASK, VALUE = range(5)

_HEADER, _RECEIVED, _SENT = protocol.HEADER.size, protocol.STAMPED_CAN_RECORD.size, protocol.CAN_RECORD.size
_KIND, _DROPPED_AT = protocol.KIND_CLASSICAL, 4
_SIZE_AT, _DATA_AT = 4, 8
_PACKET_BYTES: Final = protocol.PACKET_BYTES
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat[0]
_NO_NODE, _LAST_NODE = HEARTBEAT, HEARTBEAT + LAST_NODE
_O_SIZE = lay.O_SIZE
_SECOND_NS = 1_000_000_000
_OCTET = np.dtype(np.uint8)
# Rows of the table: as `Port` has them.
_NUMBERS, _EXPECTED, _CHECKS, _ANSWERS, _LEFT, _DATA, _IN, _OUT, _TIME = range(9)

_OF_TIME = 2  # room for a timespec

_G_NUMBERS, _G_LENGTHS, _G_COB_IDS, G_SIZES, G_DATA, _G_PACKETS = range(6)  # as `Gathered` has them
#: Most frames and packets that are gathered in a cycle.
_MOST_FRAMES, _MOST_PACKETS = 512, 64

Pairs = NDArray[np.int64]


def buffer() -> Bytes:
    """Room for a packet."""
    return np.zeros(_PACKET_BYTES, np.uint8)


@dataclass(frozen=True)
class Port:
    """Arrays for decoding and making packets, in the order of the table. They are to be kept.

    `expected` (N, 2): COB-ID and size of each frame; the bench's heartbeat may come before the last one. `checks`
    (M, 5): values that must be unchanged. `answers` (A, 2): COB-ID and size of those after them. `left` and `data`,
    (8 F,): as of `kernel.Vectors`, of both.
    """

    numbers: Whole
    expected: Pairs
    checks: Pairs
    answers: Pairs
    left: Whole
    data: Bytes
    received: Bytes
    sent: Bytes
    timespec: Whole

    def table(self) -> Table:
        """Table of the arrays' addresses; numbers that are addresses are set, too."""
        self.numbers[IN_AT], self.numbers[OUT_AT] = self.received.ctypes.data, self.sent.ctypes.data
        self.numbers[TIME_AT] = self.timespec.ctypes.data
        self.sent[:_HEADER] = np.frombuffer(protocol.HEADER.pack(_KIND, 0), np.uint8)
        return table_of([getattr(self, each.name).view(np.int64) for each in fields(self)])


def new_port(
    descriptor: int,
    dropped: int,
    expected: Pairs,
    checks: Pairs,
    answers: Pairs,
    left: Whole,
    data: Bytes,
    received: Bytes,
) -> Port:
    """Make a port with its buffers. `descriptor`: a socket of the embedded bus; `dropped`: by the bus so far."""
    numbers = np.zeros(PLACES, np.int64)
    numbers[DESCRIPTOR], numbers[DROPPED] = descriptor, dropped & 0xFFFFFFFF
    sent = np.zeros(_HEADER + _SENT * len(answers), np.uint8)
    return Port(numbers, expected, checks, answers, left, data, received, sent, np.zeros(_OF_TIME, np.int64))


class Gathered:
    """Frames and packets received since SYNC. `dropped`: frames lost by the bus so far."""

    def __init__(self, descriptor: int, dropped: int) -> None:
        self.numbers, self._lengths = np.zeros(PLACES, np.int64), np.zeros(_MOST_PACKETS, np.int64)
        self._cob_ids, self._sizes = np.zeros(_MOST_FRAMES, np.int64), np.zeros(_MOST_FRAMES, np.int64)
        self.data = np.zeros(8 * _MOST_FRAMES, np.uint8)
        self._packets = np.zeros(2 * _PACKET_BYTES, np.uint8)
        self.numbers[DESCRIPTOR], self.numbers[DROPPED] = descriptor, dropped & 0xFFFFFFFF
        self.numbers[IN_AT] = self._packets.ctypes.data
        arrays = self.numbers, self._lengths, self._cob_ids, self._sizes, self.data, self._packets
        self.table = table_of([each.view(np.int64) for each in arrays])
        self._numbers_at, self._cob_ids_at = self.numbers.data, self._cob_ids.data

    def begin(self) -> None:
        """Clear all frames and packets."""
        numbers = self._numbers_at
        numbers[CAME] = numbers[ANSWERS_CAME] = numbers[PACKETS_CAME] = numbers[IN_END] = 0

    def put(self, packet: bytes) -> None:
        """Add a packet received by the interpreter after `gather` had none: to be TAKEN."""
        at = self._numbers_at[IN_END]
        self._packets[at : at + len(packet)] = np.frombuffer(packet, np.uint8)
        self._numbers_at[LENGTH] = len(packet)

    @property
    def cob_ids(self) -> tuple[int, ...]:
        """COB-IDs of the frames."""
        return tuple(self._cob_ids_at[: self._numbers_at[CAME]].tolist())

    @property
    def packets(self) -> list[bytes]:
        """Packets as received."""
        lengths = self._lengths[: self._numbers_at[PACKETS_CAME]].tolist()
        ends = np.cumsum(lengths).tolist()
        return [self._packets[end - length : end].tobytes() for length, end in zip(lengths, ends, strict=True)]


@compiled
def _number(octets: Bytes, at: int, width: int) -> int:
    """Little-endian."""
    value = np.int64(0)
    for k in range(width):
        value |= np.int64(octets[at + k]) << 8 * k
    return int(value)


@compiled
def _heartbeat_in(packet: Bytes, length: int, dropped: int, expected: Pairs) -> int:
    """Return 0 if a packet is as expected; the COB-ID of the heartbeat if that is in it as well; else -1."""
    count = len(expected)
    records = (length - _HEADER) // _RECEIVED
    extra = records - count
    if _HEADER + records * _RECEIVED != length or extra < 0 or extra > 1 or packet[0] != _KIND:
        return -1
    if _number(packet, _DROPPED_AT, 4) != dropped:
        return -1
    found = 0
    for k in range(records):
        at = _HEADER + _RECEIVED * k
        cob_id, size = _number(packet, at, 4), packet[at + _SIZE_AT]
        if extra == 1 and k == records - 2:
            if not _NO_NODE < cob_id <= _LAST_NODE or size != 1 or packet[at + _DATA_AT] != _OPERATIONAL:
                return -1
            found = cob_id
            continue
        row = k - extra if k == records - 1 else k
        if cob_id != expected[row, COB_ID] or size != expected[row, SIZE]:
            return -1
    return found


@compiled
def _passes(octets: Bytes, first: int, each: int, checks: Pairs) -> bool:
    """True if all checked values are unchanged, in data from `first` on with `each` octets per frame."""
    misfits = 0
    for k in range(len(checks)):
        at = first + each * checks[k, RECORD_OF] + checks[k, OFFSET]
        misfits += _number(octets, at, checks[k, WIDTH]) & checks[k, MASK] != checks[k, VALUE]
    return misfits == 0


@compiled
def _put(packet: Bytes, at: int, data: Bytes, row: int) -> None:
    """Data of the record there to where those of its frame are."""
    for octet in range(8):
        data[8 * row + octet] = packet[at + _DATA_AT + octet]


@compiled
def _take(packet: Bytes, length: int, expected: Pairs, data: Bytes) -> None:
    """Data of the frames that are expected."""
    count, records = len(expected), (length - _HEADER) // _RECEIVED
    for row in range(count):
        _put(packet, _HEADER + _RECEIVED * (row if row < count - 1 else records - 1), data, row)


@compiled
def _pack(answers: Pairs, first: int, bits_of: Whole, data: Bytes, out: Bytes) -> int:
    """Pack records of the frames after the `first` that have bits on the wire; returns the packet's length."""
    at = _HEADER
    for k in range(len(answers)):
        if bits_of[first + k] == 0:
            continue
        for octet in range(4):
            out[at + octet] = answers[k, COB_ID] >> 8 * octet & 0xFF
        out[at + _SIZE_AT] = answers[k, SIZE]
        for octet in range(8):
            out[at + _DATA_AT + octet] = data[8 * (first + k) + octet]
        at += _SENT
    return at


@compiled
def _gather(packet: Bytes, length: int, numbers: Whole, cob_ids: Whole, sizes: Whole, data: Bytes) -> bool:
    """Add the frames of one more packet; False where frames were lost, or there is no room."""
    records = (length - _HEADER) // _RECEIVED
    if _HEADER + records * _RECEIVED != length or packet[0] != _KIND:
        return False
    if _number(packet, _DROPPED_AT, 4) != numbers[DROPPED] or numbers[CAME] + records > len(cob_ids):
        return False
    for k in range(records):
        at, row = _HEADER + _RECEIVED * k, numbers[CAME]
        cob_ids[row], sizes[row] = _number(packet, at, 4), packet[at + _SIZE_AT]
        _put(packet, at, data, row)
        numbers[CAME] += 1
        numbers[ANSWERS_CAME] += not _NO_NODE < cob_ids[row] <= _LAST_NODE
    return True


#: answer(table of `kernel.Vectors`, table of `Port`, where to begin): receive a packet, process it as `exchange`
#: does, and send the answers; returns the outcome.
#: ask(table of `kernel.Vectors`, table of `Port`, bitrate): send the frames; OTHER, and nothing done, where
#: a value does not fit, or a packet has come before, which is in the buffer then.
#: gather(table of `Gathered`, answers, where to begin): receive packets until so many frames that are no heartbeats
#: have come: ANSWERED; OTHER: a packet is of another kind, or reports lost frames.
#: take_apart(table of `kernel.Vectors`, table of `Port`, table of `Gathered`, bitrate): decode the frames gathered as
#: `exchange` does; False, and nothing done, where they are not as expected.
@entry_point(TABLE, TABLE, COUNT)
def answer(table: Table, port: Table, stage: int) -> int:
    if len(port) == 0:
        return NOTHING
    numbers, packet = integers(port, _NUMBERS, (1,)), viewed(integers(port, _IN, (1,)), _OCTET)
    expected, checks = integers(port, _EXPECTED, (1, 2)), integers(port, _CHECKS, (1, 2))
    data, left = viewed(integers(port, _DATA, (1,)), _OCTET), integers(port, _LEFT, (1,))
    if stage == RECEIVE:
        length = recv(numbers[DESCRIPTOR], numbers[IN_AT], _PACKET_BYTES, 0)
        if length <= 0:
            return NOTHING
        numbers[LENGTH] = length
    length, timespec = numbers[LENGTH], integers(port, _TIME, (1,))
    clock_gettime(CLOCK_MONOTONIC, numbers[TIME_AT])
    numbers[NOW_NS] = timespec[0] * _SECOND_NS + timespec[1]
    heartbeat = _heartbeat_in(packet, length, numbers[DROPPED], expected)
    if (
        heartbeat < 0
        or numbers[NOW_NS] > numbers[UNTIL_NS]
        or not _passes(packet, _HEADER + _DATA_AT, _RECEIVED, checks)
    ):
        return OTHER
    if heartbeat > 0 and stage != RECEIVED:
        numbers[HEARTBEAT_OF] = heartbeat
        return ALIVE
    _take(packet, length, expected, data)
    if kernel.exchange(BITRATE, table) != CONTINUE:
        return OTHER
    answers = integers(port, _ANSWERS, (1, 2))
    if len(answers) == 0:
        return ANSWERED
    out = viewed(integers(port, _OUT, (1,)), _OCTET)
    numbers[OUT_LENGTH] = _pack(answers, len(expected), left[_O_SIZE:], data, out)
    sent = send(numbers[DESCRIPTOR], numbers[OUT_AT], numbers[OUT_LENGTH], MSG_DONTWAIT | MSG_NOSIGNAL)
    return ANSWERED if sent == numbers[OUT_LENGTH] else UNSENT


@entry_point(TABLE, TABLE, COUNT)
def ask(table: Table, port: Table, bitrate: int) -> int:
    if len(port) == 0:
        return NOTHING
    numbers, left = integers(port, _NUMBERS, (1,)), integers(port, _LEFT, (1,))
    length = recv(numbers[DESCRIPTOR], numbers[IN_AT], _PACKET_BYTES, MSG_DONTWAIT)
    numbers[LENGTH] = max(length, 0)
    if length >= 0 or kernel.exchange(bitrate, table) != CONTINUE:
        return OTHER
    data, out = viewed(integers(port, _DATA, (1,)), _OCTET), viewed(integers(port, _OUT, (1,)), _OCTET)
    numbers[OUT_LENGTH] = _pack(integers(port, _ANSWERS, (1, 2)), 0, left[_O_SIZE:], data, out)
    sent = send(numbers[DESCRIPTOR], numbers[OUT_AT], numbers[OUT_LENGTH], MSG_DONTWAIT | MSG_NOSIGNAL)
    return ANSWERED if sent == numbers[OUT_LENGTH] else UNSENT


@entry_point(TABLE, COUNT, COUNT)
def gather(gathered: Table, answers: int, stage: int) -> int:
    if len(gathered) == 0:
        return NOTHING
    numbers, lengths = integers(gathered, _G_NUMBERS, (1,)), integers(gathered, _G_LENGTHS, (1,))
    cob_ids, sizes = integers(gathered, _G_COB_IDS, (1,)), integers(gathered, G_SIZES, (1,))
    data = viewed(integers(gathered, G_DATA, (1,)), _OCTET)
    packets = viewed(integers(gathered, _G_PACKETS, (1,)), _OCTET)
    while numbers[ANSWERS_CAME] < answers:
        end, count = numbers[IN_END], numbers[PACKETS_CAME]
        if end + _PACKET_BYTES > len(packets) or count == len(lengths):
            return OTHER
        if stage == RECEIVE:
            length = recv(numbers[DESCRIPTOR], numbers[IN_AT] + end, _PACKET_BYTES, 0)
            if length <= 0:
                return NOTHING
            numbers[LENGTH] = length
        stage, length = RECEIVE, numbers[LENGTH]
        lengths[count] = length
        numbers[PACKETS_CAME] += 1
        numbers[IN_END] += length
        if not _gather(packets[end : end + length], length, numbers, cob_ids, sizes, data):
            return OTHER
    return ANSWERED


@entry_point(TABLE, TABLE, TABLE, COUNT)
def take_apart(table: Table, order: Table, gathered: Table, bitrate: int) -> bool:
    if len(order) == 0:
        return False
    expected, checks = integers(order, _EXPECTED, (1, 2)), integers(order, _CHECKS, (1, 2))
    sizes, data = integers(gathered, G_SIZES, (1,)), viewed(integers(order, _DATA, (1,)), _OCTET)
    came = viewed(integers(gathered, G_DATA, (1,)), _OCTET)
    for row in range(len(expected)):
        if sizes[row] != expected[row, SIZE]:
            return False
    if not _passes(came, 0, 8, checks):
        return False
    for k in range(8 * len(expected)):
        data[k] = came[k]
    return kernel.exchange(bitrate, table) == CONTINUE


def warm_up() -> None:
    """Compile, or load from the cache, the functions that devices call, before a cycle has to wait for them."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    answer(nothing, nothing, RECEIVE)
    warm_up_gathering()


def warm_up_bench() -> None:
    """Load the compiled functions that a bench calls."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    ask(nothing, nothing, BITRATE)
    warm_up_gathering()


def warm_up_gathering() -> None:
    """Load the compiled functions that gather and decode answers."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    gather(nothing, 0, RECEIVE)
    take_apart(nothing, nothing, nothing, BITRATE)
