"""The bench's part of a plain cycle where time is real, in packets of the embedded bus: set points ahead of SYNC, SYNC
at its deadline or that of a thread waited for, answers until all that are due have come or their time is over.

Who waits here keeps nobody from anything: the interpreter's lock is not held. Whatever has come of a cycle stays in the
buffer of the port until the cycle is over, for Python.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from hilbench import c_library
from hilbench.c_library import (
    CLOCK_MONOTONIC,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    TIMER_ABSTIME,
    clock_gettime,
    clock_nanosleep,
    send,
)
from hilbench.can import protocol
from hilbench.can.compiled_wire import bits_on_wire
from hilbench.canopen.identifiers import NmtState
from hilbench.chain import GOES_ON
from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    integers,
    number_of_sources,
    table_of,
    viewed,
)
from hilbench.plain import kernel, packet_kernel
from hilbench.plain import layout as lay
from hilbench.plain.kernel import Table, trace_line
from hilbench.plain.layout import Bytes, Row, Rows, Whole
from hilbench.plain.packet_kernel import (
    ANSWERED,
    COB_ID,
    DESCRIPTOR,
    LENGTH,
    LOOKED_AT,
    NOTHING,
    NOW_NS,
    OTHER,
    OUT_AT,
    OUT_LENGTH,
    SIZE,
    SYNCED,
    UNSENT,
    Pairs,
    append_all,
    number,
    pack,
    put,
    wait,
)

#: Places in `Heard.places`: where in the buffer what came behind SYNC begins (0: SYNC is not out yet); whether SYNC is
#: among what came; how many of the known frames are answers; bit times of all frames of the cycle, and where its text
#: ends.
BEHIND_AT, SYNC_CAME, ANSWERS, BITS, TEXT_END, PLACES = range(6)

_HEADER, _RECEIVED = protocol.HEADER.size, protocol.STAMPED_CAN_RECORD.size
_SIZE_AT, _DATA_AT, _STAMP_AT = 4, 8, 16
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat[0]
_SECOND_NS = 1_000_000_000
_O_SIZE, _O_BITS = lay.O_SIZE, lay.O_BITS
_FRAME = lay.FRAME
_OCTET = np.dtype(np.uint8)
# Rows of `packet_kernel.Port`.
_NUMBERS, _EXPECTED, _, _SENT_WIRE, _LEFT, _SENT_DATA, _IN, _OUT, _TIME = range(9)
# Rows of the table: as `Heard` has them.
_PLACES, _CAME, _DUE, _DATA, _KNOWN, _SENT, _HEADS, _TEXT = range(8)


@dataclass(frozen=True)
class Heard:
    """What a bench hears in a cycle, by the known frames (K,) that a port expects: answers, heartbeats, SYNC the last;
    in the order of the table. Arrays are to be kept.

    `came`: which have; `due`: which have to; `data` (8 K,); `known`, `sent`: rows of `layout.FRAME`, of these and of
    what the bench sends, SYNC the last; `heads`, `text`: as of `kernel.Vectors`.
    """

    places: Whole
    came: Whole
    due: Whole
    data: Bytes
    known: Rows
    sent: Rows
    heads: Bytes
    text: Bytes

    def table(self) -> Table:
        """Where they stand."""
        return table_of([getattr(self, each.name).view(np.int64) for each in fields(self)])


@compiled
def _now_ns(time: Whole) -> int:
    """Of the monotonic clock."""
    clock_gettime(CLOCK_MONOTONIC, time.ctypes.data)
    return int(time[0] * _SECOND_NS + time[1])


@compiled
def _sleep(time: Whole, until_ns: int) -> int:
    """As clock_nanosleep(2)."""
    time[0], time[1] = until_ns // _SECOND_NS, until_ns % _SECOND_NS
    return int(clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, time.ctypes.data, 0))


@compiled
def _place_of(expected: Pairs, cob_id: int, likely: int) -> int:
    """The row of an identifier, -1: none."""
    for further in range(len(expected)):
        row = (likely + further) % len(expected)
        if expected[row, COB_ID] == cob_id:
            return row
    return -1


@compiled
def _sort(port: Table, heard: Table) -> bool:
    """What was not looked at yet to its places; False where something is among it that is no part of a plain cycle."""
    numbers, packet = integers(port, _NUMBERS, (1,)), viewed(integers(port, _IN, (1,)), _OCTET)
    expected, places = integers(port, _EXPECTED, (1, 2)), integers(heard, _PLACES, (1,))
    came, data = integers(heard, _CAME, (1,)), viewed(integers(heard, _DATA, (1,)), _OCTET)
    sync, row = len(expected) - 1, -1
    while max(numbers[LOOKED_AT], _HEADER) < numbers[LENGTH]:
        at = max(numbers[LOOKED_AT], _HEADER)
        row = _place_of(expected, number(packet, at, 4), row + 1)
        if row < 0 or expected[row, SIZE] != packet[at + _SIZE_AT] or came[row] != 0:
            return False
        if row == sync:
            if places[BEHIND_AT] != 0:
                return False
            places[SYNC_CAME], places[BEHIND_AT] = 1, at + _RECEIVED
        elif row < places[ANSWERS]:
            if places[BEHIND_AT] == 0:  # late
                return False
        elif packet[at + _DATA_AT] != _OPERATIONAL:
            return False
        came[row], numbers[LOOKED_AT] = 1, at + _RECEIVED
        put(packet, at, data, row)
    return True


@compiled
def _missing_ns(heard: Table, bitrate: int) -> int:
    """How long all answers that are due and have not come need on the wire at least, but for the longest of them; 0
    where only one is, -1: none; -2: one has come that is not due."""
    came, due, places = integers(heard, _CAME, (1,)), integers(heard, _DUE, (1,)), integers(heard, _PLACES, (1,))
    known = viewed(integers(heard, _KNOWN, (1,)), _FRAME)
    bits, longest = 0, 0
    for row in range(places[ANSWERS]):
        if came[row] > due[row]:
            return -2
        if due[row] > came[row]:
            bits += known[row].bits
            longest = max(longest, known[row].bits)
    return (bits - longest) * _SECOND_NS // bitrate if bits > 0 else -1


@compiled
def _line_of(frame: Row, time_ns: int, data: Bytes, heard: Table, at: int) -> int:
    """That of a frame into the text; where the next one begins."""
    frame.time_ns = time_ns
    text = viewed(integers(heard, _TEXT, (1,)), _OCTET)
    return trace_line(frame, viewed(integers(heard, _HEADS, (1,)), _OCTET), data, text, at) if len(text) > 0 else at


@compiled
def _account_sent(port: Table, heard: Table, start_ns: int, bit_ns: float) -> None:
    """`SyncCycle` with the times of what the bench has sent before SYNC, which end there where `start_ns` is."""
    left, places = integers(port, _LEFT, (1,)), integers(heard, _PLACES, (1,))
    sent, data = viewed(integers(heard, _SENT, (1,)), _FRAME), viewed(integers(port, _SENT_DATA, (1,)), _OCTET)
    at_bits = 0
    for row in range(len(sent) - 1):
        bits = left[_O_SIZE + row]
        if bits != 0:
            at_bits += bits
            time_ns = start_ns + int(at_bits * bit_ns)
            places[TEXT_END] = _line_of(sent[row], time_ns, data[8 * row :], heard, places[TEXT_END])


@compiled
def _account_came(port: Table, heard: Table, first: int, end: int) -> None:
    """`SyncCycle` with what has come in this part of the buffer."""
    packet, expected = viewed(integers(port, _IN, (1,)), _OCTET), integers(port, _EXPECTED, (1, 2))
    places, known, row = integers(heard, _PLACES, (1,)), viewed(integers(heard, _KNOWN, (1,)), _FRAME), -1
    for at in range(first, end, _RECEIVED):
        row = _place_of(expected, number(packet, at, 4), row + 1)
        frame, data = known[row], packet[at + _DATA_AT :]
        places[BITS] += bits_on_wire(frame.crc, frame.stuffing, frame.bits, data, frame.size)
        places[TEXT_END] = _line_of(frame, number(packet, at + _STAMP_AT, 8), data, heard, places[TEXT_END])


@compiled
def _bits_of(port: Table, heard: Table, first: int, end: int) -> int:
    """Bit times of what has come in this part of the buffer."""
    packet, expected = viewed(integers(port, _IN, (1,)), _OCTET), integers(port, _EXPECTED, (1, 2))
    known, bits = viewed(integers(heard, _KNOWN, (1,)), _FRAME), 0
    for at in range(first, end, _RECEIVED):
        frame = known[_place_of(expected, number(packet, at, 4), 0)]
        bits += bits_on_wire(frame.crc, frame.stuffing, frame.bits, packet[at + _DATA_AT :], frame.size)
    return bits


Tell = Callable[[Table, Table, Table, int], int]
AwaitSync = Callable[[Table, Table, int], int]
SendSync = Callable[[Table, Table, Table, int, int], int]
AwaitAnswers = Callable[[Table, Table, Table, int, int], int]
Account = Callable[[Table, Table, int, int], None]


def _entry_points(sources: int) -> tuple[Tell, AwaitSync, SendSync, AwaitAnswers, Account]:
    """The compiled functions that Python calls; `sources` as in `compiled.number_of_sources`."""

    @entry_point(TABLE, TABLE, TABLE, COUNT)
    def tell(table: Table, port: Table, heard: Table, bitrate: int) -> int:
        if sources < 0 or len(port) == 0:
            return NOTHING
        numbers, places = integers(port, _NUMBERS, (1,)), integers(heard, _PLACES, (1,))
        came, left = integers(heard, _CAME, (1,)), integers(port, _LEFT, (1,))
        numbers[LENGTH] = numbers[LOOKED_AT] = places[BEHIND_AT] = places[SYNC_CAME] = 0
        came[:] = 0
        if kernel.exchange(bitrate, table) != GOES_ON:
            return OTHER
        data, out = viewed(integers(port, _SENT_DATA, (1,)), _OCTET), viewed(integers(port, _OUT, (1,)), _OCTET)
        length = pack(integers(port, _SENT_WIRE, (1, 2)), 0, left[_O_SIZE:], data, out)
        numbers[OUT_LENGTH] = length
        sent = send(numbers[DESCRIPTOR], numbers[OUT_AT], length, MSG_DONTWAIT | MSG_NOSIGNAL)
        return ANSWERED if sent == length else UNSENT

    @entry_point(TABLE, TABLE, COUNT)
    def await_sync(port: Table, heard: Table, until_ns: int) -> int:
        if sources < 0 or len(port) == 0:
            return NOTHING
        time, places = integers(port, _TIME, (1,)), integers(heard, _PLACES, (1,))
        waited = False
        while True:
            count = append_all(port)
            if count < 0 or (waited and count == 0) or not _sort(port, heard):
                return OTHER
            if places[BEHIND_AT] != 0:
                return SYNCED
            now_ns = _now_ns(time)
            if now_ns >= until_ns or not wait(port, until_ns - now_ns):
                return NOTHING
            waited = True

    @entry_point(TABLE, TABLE, TABLE, COUNT, COUNT)
    def send_sync(port: Table, heard: Table, packet: Table, length: int, deadline_ns: int) -> int:
        if sources < 0 or len(port) == 0:
            return NOTHING
        numbers, time = integers(port, _NUMBERS, (1,)), integers(port, _TIME, (1,))
        places = integers(heard, _PLACES, (1,))
        while _sleep(time, deadline_ns) != 0:
            pass  # a signal
        numbers[NOW_NS] = _now_ns(time)
        is_plain = append_all(port) >= 0 and _sort(port, heard) and places[BEHIND_AT] == 0
        places[BEHIND_AT] = max(numbers[LENGTH], _HEADER)
        sync = integers(packet, 0, (1,))
        if send(numbers[DESCRIPTOR], sync.ctypes.data, length, MSG_DONTWAIT | MSG_NOSIGNAL) != length:
            return UNSENT
        return SYNCED if is_plain else OTHER

    @entry_point(TABLE, TABLE, TABLE, COUNT, COUNT)
    def await_answers(port: Table, heard: Table, gathered: Table, bitrate: int, until_ns: int) -> int:
        if sources < 0 or len(port) == 0:
            return NOTHING
        time, places, came = (
            integers(port, _TIME, (1,)),
            integers(heard, _PLACES, (1,)),
            integers(heard, _CAME, (1,)),
        )
        # What has come with SYNC was looked at then.
        has_come, waited = True, False
        while True:
            count = append_all(port)
            if count < 0 or (waited and count == 0) or not _sort(port, heard):
                return OTHER
            has_come, waited = has_come or count > 0, False
            missing_ns = _missing_ns(heard, bitrate)
            if missing_ns < 0:
                break
            now_ns = _now_ns(time)
            if now_ns >= until_ns:
                return NOTHING
            if has_come and missing_ns > 0:  # nobody is woken for all that the wire can't be through with
                has_come = False
                _sleep(time, min(now_ns + missing_ns, until_ns))
            elif wait(port, until_ns - now_ns):
                waited = True
        if missing_ns < -1:
            return OTHER
        expected, data = integers(port, _EXPECTED, (1, 2)), viewed(integers(heard, _DATA, (1,)), _OCTET)
        sizes = integers(gathered, packet_kernel.G_SIZES, (1,))
        taken, row = viewed(integers(gathered, packet_kernel.G_DATA, (1,)), _OCTET), 0
        for known in range(places[ANSWERS]):
            if came[known] != 0:
                sizes[row] = expected[known, SIZE]
                for octet in range(8):
                    taken[8 * row + octet] = data[8 * known + octet]
                row += 1
        return ANSWERED

    @entry_point(TABLE, TABLE, COUNT, COUNT)
    def account(port: Table, heard: Table, bitrate: int, start_ns: int) -> None:
        if sources < 0 or len(port) == 0:
            return
        numbers, left = integers(port, _NUMBERS, (1,)), integers(port, _LEFT, (1,))
        places, packet = integers(heard, _PLACES, (1,)), viewed(integers(port, _IN, (1,)), _OCTET)
        sent, bit_ns = viewed(integers(heard, _SENT, (1,)), _FRAME), 1e9 / bitrate
        sync_bits, behind_at = left[-1], places[BEHIND_AT]
        before_bits, before_end = left[_O_BITS] - sync_bits, behind_at
        if places[SYNC_CAME] != 0:
            before_end -= _RECEIVED
            start_ns = number(packet, before_end + _STAMP_AT, 8) - int(sync_bits * bit_ns)
        else:
            before_bits += _bits_of(port, heard, _HEADER, before_end)
        places[BITS], places[TEXT_END] = left[_O_BITS], 0
        _account_sent(port, heard, start_ns - int(before_bits * bit_ns), bit_ns)
        _account_came(port, heard, _HEADER, before_end)
        time_ns = start_ns + int(sync_bits * bit_ns)
        places[TEXT_END] = _line_of(sent[-1], time_ns, packet, heard, places[TEXT_END])
        _account_came(port, heard, behind_at, numbers[LENGTH])

    return tell, await_sync, send_sync, await_answers, account


#: tell(table of `kernel.Vectors`, table of `packet_kernel.Port`, table of `Heard`, bitrate): send what is in the frames
#: but for SYNC; OTHER, and nothing done, where a value does not fit.
#: await_sync(Port, Heard, until when, ns of the monotonic clock): receive packets until SYNC is there; NOTHING: not in
#: this time; OTHER: something else has come, or a second one.
#: send_sync(Port, Heard, table of the packet of SYNC, its length, when it is due): wait for that time, take what has
#: come before, and send SYNC: SYNCED; OTHER: it is sent, but something else has come; UNSENT: the bus did not take it.
#: await_answers(Port, Heard, table of `packet_kernel.Gathered`, bitrate, until when): receive packets until all that is
#: due is there, and gathered as by `packet_kernel.gather`: ANSWERED; NOTHING: not in this time; OTHER: something else
#: has come.
#: account(Port, Heard, bitrate, when SYNC began, where it has not come back): bits and lines of a cycle.
tell, await_sync, send_sync, await_answers, account = _entry_points(
    number_of_sources(
        __file__,
        str(packet_kernel.__file__),
        str(c_library.__file__),
        str(protocol.__file__),
        *kernel.SOURCES,
    )
)


def warm_up() -> None:
    """Compile, or load from the cache, before anybody waits for a cycle."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    tell(nothing, nothing, nothing, packet_kernel.BITRATE)
    await_sync(nothing, nothing, 0)
    send_sync(nothing, nothing, nothing, 0, 0)
    await_answers(nothing, nothing, nothing, packet_kernel.BITRATE, 0)
    account(nothing, nothing, packet_kernel.BITRATE, 0)
    packet_kernel.take_apart(nothing, nothing, nothing, packet_kernel.BITRATE)
