"""Packets of the embedded bus without the interpreter: received, taken apart, answered by `kernel.exchange`, sent.

What is called of the C library are recv(2), send(2) and clock_gettime(2). A packet that is not what is expected stays
in the buffer, for Python.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.can import protocol
from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, NmtState
from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    integers,
    number_of_sources,
    table_of,
)
from hilbench.plain import kernel
from hilbench.plain import layout as lay
from hilbench.plain.kernel import Table
from hilbench.plain.layout import Bytes, Whole

#: What has become of a packet: none has come; another than expected; it is that of a bench that says that it is alive,
#: which is to be heard before it is answered; answered; the same, but the bus did not take the answers.
NOTHING, OTHER, ALIVE, ANSWERED, UNSENT = range(5)
#: Where to begin: with the next packet; with that in the buffer; behind its heartbeat, which was heard.
RECEIVE, TAKEN, HEARD = range(3)
#: Places among the numbers. Of Python: the socket, addresses of both buffers and of room for a timespec, frames that
#: the bus has dropped, until when a packet is taken (ns of the monotonic clock), how long that in the buffer is. Of the
#: kernel: the same, when it was there, whose heartbeat (COB-ID) is in it, how long the answers are.
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
    PLACES,
) = range(11)
#: Bus time is the hub's: what the kernel makes of it here nobody asks for.
BITRATE = 1_000_000
#: Columns of what is expected, and of what is looked at in it: a value of these octets of a record, under a mask.
COB_ID, SIZE = range(2)
RECORD_OF, OFFSET, WIDTH, MASK, VALUE = range(5)

_HEADER, _RECEIVED, _SENT = protocol.HEADER.size, protocol.STAMPED_CAN_RECORD.size, protocol.CAN_RECORD.size
_KIND, _DROPPED_AT = protocol.KIND_CLASSICAL, 4
_SIZE_AT, _DATA_AT = 4, 8
_PACKET_BYTES: Final = protocol.PACKET_BYTES
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat[0]
_NO_NODE, _LAST_NODE = HEARTBEAT, HEARTBEAT + LAST_NODE
_O_SIZE = lay.O_SIZE
_CLOCK_MONOTONIC = 1  # <linux/time.h>
_MSG_DONTWAIT, _MSG_NOSIGNAL = 0x40, 0x4000  # <linux/socket.h>
_SECOND_NS = 1_000_000_000
_OCTET = np.dtype(np.uint8)
# Rows of the table: as `Port` has them.
_NUMBERS, _EXPECTED, _CHECKS, _ANSWERS, _LEFT, _DATA, _IN, _OUT, _TIME = range(9)

if TYPE_CHECKING:

    def _recv(descriptor: int, buffer: int, length: int, flags: int) -> int: ...

    def _send(descriptor: int, packet: int, length: int, flags: int) -> int: ...

    def _clock_gettime(clock: int, time: int) -> int: ...
else:
    from numba import types

    _recv = types.ExternalFunction("recv", types.intp(types.int32, types.intp, types.intp, types.int32))
    _send = types.ExternalFunction("send", types.intp(types.int32, types.intp, types.intp, types.int32))
    _clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))

Pairs = NDArray[np.int64]


def buffer() -> Bytes:
    """Room for a packet."""
    return np.zeros(_PACKET_BYTES, np.uint8)


@dataclass(frozen=True)
class Port:
    """What a packet is taken apart and made by, in the order of the table. Arrays are to be kept.

    `expected` (N, 2): COB-ID and size of each frame; before the last one the bench's heartbeat may stand. `checks`
    (M, 5): what has to be as it was. `answers` (A, 2): COB-ID and size of the frames behind them. `left` and `data`,
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
        """Where they stand; numbers that are addresses are set, too."""
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
    """One with room for what it sends. `descriptor`: a socket of the embedded bus; `dropped`: by the bus so far."""
    numbers = np.zeros(PLACES, np.int64)
    numbers[DESCRIPTOR], numbers[DROPPED] = descriptor, dropped & 0xFFFFFFFF
    sent = np.zeros(_HEADER + _SENT * len(answers), np.uint8)
    return Port(numbers, expected, checks, answers, left, data, received, sent, np.zeros(2, np.int64))


@compiled
def _number(octets: Bytes, at: int, width: int) -> int:
    """Little-endian."""
    value = np.int64(0)
    for k in range(width):
        value |= np.int64(octets[at + k]) << 8 * k
    return int(value)


@compiled
def _heartbeat_in(packet: Bytes, length: int, dropped: int, expected: Pairs) -> int:
    """0 where a packet has what is expected; the COB-ID of the heartbeat that is in it as well; -1: another one."""
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
def _passes(packet: Bytes, checks: Pairs) -> bool:
    """Whether what has to be as it was is so."""
    misfits = 0
    for k in range(len(checks)):
        at = _HEADER + _RECEIVED * checks[k, RECORD_OF] + _DATA_AT + checks[k, OFFSET]
        misfits += _number(packet, at, checks[k, WIDTH]) & checks[k, MASK] != checks[k, VALUE]
    return misfits == 0


@compiled
def _take(packet: Bytes, length: int, expected: Pairs, data: Bytes) -> None:
    """Data of the frames that are expected."""
    count, records = len(expected), (length - _HEADER) // _RECEIVED
    for row in range(count):
        at = _HEADER + _RECEIVED * (row if row < count - 1 else records - 1) + _DATA_AT
        for k in range(8):
            data[8 * row + k] = packet[at + k]


@compiled
def pack(answers: Pairs, first: int, bits_of: Whole, data: Bytes, out: Bytes) -> int:
    """Records of the frames behind the `first` that have bits on the wire; how long the packet is."""
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


Answer = Callable[[Table, Table, int], int]


def _entry_point(sources: int) -> Answer:
    """The compiled function that Python calls; `sources` as in `compiled.number_of_sources`."""

    @entry_point(TABLE, TABLE, COUNT)
    def answer(table: Table, port: Table, stage: int) -> int:
        if sources < 0 or len(port) == 0:
            return NOTHING
        numbers, packet = integers(port, _NUMBERS, (1,)), integers(port, _IN, (1,)).view(_OCTET)
        if stage == RECEIVE:
            length = _recv(numbers[DESCRIPTOR], numbers[IN_AT], _PACKET_BYTES, 0)
            if length <= 0:
                return NOTHING
            numbers[LENGTH] = length
        length = numbers[LENGTH]
        timespec = integers(port, _TIME, (1,))
        _clock_gettime(_CLOCK_MONOTONIC, numbers[TIME_AT])
        numbers[NOW_NS] = timespec[0] * _SECOND_NS + timespec[1]
        expected, checks = integers(port, _EXPECTED, (1, 2)), integers(port, _CHECKS, (1, 2))
        heartbeat = _heartbeat_in(packet, length, numbers[DROPPED], expected)
        if heartbeat < 0 or numbers[NOW_NS] > numbers[UNTIL_NS] or not _passes(packet, checks):
            return OTHER
        if heartbeat > 0 and stage != HEARD:
            numbers[HEARTBEAT_OF] = heartbeat
            return ALIVE
        data, left = integers(port, _DATA, (1,)).view(_OCTET), integers(port, _LEFT, (1,))
        _take(packet, length, expected, data)
        if not kernel.exchange(table, BITRATE):
            return OTHER
        answers = integers(port, _ANSWERS, (1, 2))
        if len(answers) == 0:
            return ANSWERED
        out = integers(port, _OUT, (1,)).view(_OCTET)
        numbers[OUT_LENGTH] = pack(answers, len(expected), left[_O_SIZE:], data, out)
        sent = _send(numbers[DESCRIPTOR], numbers[OUT_AT], numbers[OUT_LENGTH], _MSG_DONTWAIT | _MSG_NOSIGNAL)
        return ANSWERED if sent == numbers[OUT_LENGTH] else UNSENT

    return answer


#: answer(table of `kernel.Vectors`, table of `Port`, where to begin): receive a packet, do with it what `exchange`
#: does, and send what is to be answered; what has become of it.
answer = _entry_point(number_of_sources(__file__, *kernel.SOURCES))


def warm_up() -> None:
    """Compile, or load from the cache, before anybody waits for a cycle."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    answer(nothing, nothing, RECEIVE)
