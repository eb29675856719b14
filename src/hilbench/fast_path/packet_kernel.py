"""Packets of the embedded bus without the interpreter: what comes is put into the process image, what is to be sent is
taken from it.

Each entry point is called with the bit rate and the table of a `Port`. Functions called of the C library are recv(2),
send(2) and clock_gettime(2). What was not expected stays in the buffer, for the interpreter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.c_library import CLOCK_MONOTONIC, MSG_DONTWAIT, MSG_NOSIGNAL, clock_gettime, recv, send
from hilbench.can import protocol
from hilbench.can.compiled_wire import OCTET, RECORD, RECORD_BYTES, STAMPED, STAMPED_BYTES
from hilbench.compiled import (
    COUNT,
    TABLE,
    Record,
    Table,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    merged,
    record_type,
    records,
    table_of,
    viewed,
)
from hilbench.cycle_program import CONTINUE
from hilbench.fast_path import kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.kernel import Image
from hilbench.fast_path.layout import Bytes

#: What is returned in the place of CONTINUE: no packet has come yet; one is not as expected, nothing was done with it,
#: or nothing is to be sent; the bus did not take what was sent, which is in `out`.
NOTHING, OTHER, UNSENT = 1, 2, 3
#: Bus time is the hub's: that of devices is not used.
BITRATE = 1_000_000

#: State of a port. Of Python: the socket; frames that the bus has dropped; until when packets are taken (ns of the
#: monotonic clock); ends of the frames before the answers, and of the own answers among these; octets of a packet that
#: Python has put behind the others. Of the kernel: when a packet was there; rows of the frames that are awaited now,
#: how many have come, and are missing; packets, and their end; octets to be sent.
STATE = record_type(
    *("descriptor", "dropped", "until_ns", "asked", "answers", "taken"),
    *("now_ns", "first", "last", "came", "missing", "packets", "end", "out"),
    of=np.int64,
)
#: A value that must be as it is: of these octets of a frame, under a mask.
CHECK = record_type("frame", "offset", "width", "mask", "value", of=np.int64)
_WORD = np.dtype(np.uint64)
_HEADER, _PACKET_BYTES = protocol.HEADER.size, protocol.PACKET_BYTES
_KIND, _DROPPED_AT = protocol.KIND_CLASSICAL, 4
_BY_CYCLES = lay.BY_CYCLES
_SECOND_NS = 1_000_000_000
#: Most packets that are gathered.
_MOST_PACKETS: Final = 64


class Port(NamedTuple):
    """What comes in packets, and goes out. Frames of the image that are sent before SYNC, and it, are the first, then
    come own answers, then those of others."""

    image: Image
    state: Annotated[Any, STATE]
    checks: Annotated[Any, records(CHECK)]
    is_here: Wholes  #: by frame: 1, if it was received
    received: Annotated[Any, records(_WORD)]  #: by frame
    in_order: Wholes  #: rows in the order in which they came
    lengths: Wholes
    packets: Annotated[Any, records(OCTET)]
    out: Annotated[Any, records(OCTET)]
    timespec: Wholes


class PacketPort:
    """Makes a `Port`, whose `table` is that of the entry points, for a socket of the embedded bus.

    `asked`, `answers`: ends of the frames before the answers, and of the own answers; `checks`: rows of `CHECK`.
    """

    def __init__(
        self, image: Image, descriptor: int, dropped: int, asked: int, answers: int, checks: Sequence[tuple[int, ...]]
    ) -> None:
        count, self._lengths = len(image.frames), np.zeros(_MOST_PACKETS, np.int64)
        self._packets, self._out = (
            np.zeros(2 * _PACKET_BYTES, np.uint8),
            np.zeros(_HEADER + RECORD_BYTES * count, np.uint8),
        )
        self._out[:_HEADER] = np.frombuffer(protocol.HEADER.pack(_KIND, 0), np.uint8)
        state = np.zeros(1, STATE)
        self.state = state[0]
        self.state["descriptor"], self.state["dropped"] = descriptor, dropped & 0xFFFFFFFF
        self.state["asked"], self.state["answers"] = asked, answers
        port = Port(
            image,
            state,
            np.array(checks, CHECK),
            np.zeros(count, np.int64),
            np.zeros(count, np.uint64),
            np.zeros(count, np.int64),
            self._lengths,
            self._packets,
            self._out,
            np.zeros(2, np.int64),
        )
        self._kept = port
        self.table = table_of(port)

    def put(self, packet: bytes) -> None:
        """Put a packet behind those that have come."""
        at = self.state["end"]
        self._packets[at : at + len(packet)] = np.frombuffer(packet, np.uint8)
        self.state["taken"] = len(packet)

    @property
    def packets(self) -> list[bytes]:
        """Packets that have come since frames are awaited."""
        state = self.state
        lengths = [*self._lengths[: state["packets"]].tolist(), *filter(None, (int(state["taken"]),))]
        ends = np.cumsum(lengths).tolist()
        return [self._packets[end - length : end].tobytes() for length, end in zip(lengths, ends, strict=True)]

    @property
    def unsent(self) -> bytes:
        """Records of the packet that the bus did not take."""
        return self._out[_HEADER : self.state["out"]].tobytes()


@compiled
def _number(octets: Bytes, at: int, width: int) -> int:
    """Little-endian."""
    value = np.int64(0)
    for k in range(width):
        value |= np.int64(octets[at + k]) << 8 * k
    return int(value)


@compiled
def _comes(frame: Record) -> bool:
    """True if a frame has to come in this cycle."""
    return bool(frame.timing == _BY_CYCLES and frame.count + 1 >= frame.every)


@merged
def _await(port: Port, first: int, last: int) -> None:
    """Await frames in these rows from now on."""
    state, frames = port.state, port.image.frames
    state.first, state.last = first, last
    state.came = state.missing = state.packets = state.end = 0
    for k in range(first, last):
        state.missing += _comes(frames[k])
        port.is_here[k] = 0


@merged
def _stage(port: Port, end: int, length: int) -> bool:
    """Take the frames of a packet; False where one is not awaited, or frames were lost."""
    state, frames, octets = port.state, port.image.frames, port.packets[end : end + length]
    came = viewed(octets[_HEADER:], STAMPED)
    fits = octets[0] == _KIND and len(came) * STAMPED_BYTES + _HEADER == length
    fits = fits and _number(octets, _DROPPED_AT, 4) == state.dropped
    row, count = state.first, state.last - state.first
    for k in range(len(came) if fits else 0):
        looked = 0
        while looked < count and frames[row].cob_id != came[k].can_id:
            row = row + 1 if row + 1 < state.last else state.first
            looked += 1
        if looked >= count:
            return False
        frame = frames[row]
        is_due = _comes(frame)
        if port.is_here[row] != 0 or frame.size != came[k].size or (frame.timing == _BY_CYCLES and not is_due):
            return False
        port.is_here[row], port.received[row], port.in_order[state.came] = 1, came[k].data, row
        state.came += 1
        state.missing -= is_due
    return bool(fits)


@merged
def _receive(port: Port) -> int:
    """Receive packets until no frame is missing; or NOTHING, OTHER."""
    state, outcome = port.state, CONTINUE
    while outcome == CONTINUE and state.missing > 0:
        length, end = state.taken, state.end
        if state.packets == len(port.lengths) or end + _PACKET_BYTES > len(port.packets):
            return OTHER
        if length == 0:
            length = recv(state.descriptor, port.packets.ctypes.data + end, _PACKET_BYTES, 0)
        if length <= 0:
            return NOTHING
        port.lengths[state.packets] = length
        state.packets += 1
        state.end += length
        state.taken = 0
        if not _stage(port, end, length):
            outcome = OTHER
    return outcome


@merged
def _now_ns(port: Port) -> int:
    """Time of the monotonic clock."""
    clock_gettime(CLOCK_MONOTONIC, port.timespec.ctypes.data)
    return int(port.timespec[0] * _SECOND_NS + port.timespec[1])


@merged
def _accept(port: Port, bitrate: int) -> bool:
    """Put the frames that have come into the image; False, and nothing done, where a value is not as it was."""
    state, image = port.state, port.image
    received, data = viewed(port.received, OCTET), viewed(image.data, _WORD)
    misfits = 0
    for k in range(len(port.checks)):
        check = port.checks[k]
        if state.first <= check.frame < state.last and port.is_here[check.frame] != 0:
            found = _number(received, 8 * check.frame + check.offset, check.width)
            misfits += found & check.mask != check.value
    if misfits:
        return False
    for k in range(state.first, state.last):
        if image.frames[k].timing == _BY_CYCLES:
            kernel.is_due(image.frames[k], 0)
    for k in range(state.came):
        row = port.in_order[k]
        data[row] = port.received[row]
        kernel.carry(image, row, bitrate)
    return True


@merged
def _send(port: Port, first: int, last: int) -> int:
    """Send the frames in these rows that are in this cycle; UNSENT where the bus did not take them."""
    state, frames, data = port.state, port.image.frames, viewed(port.image.data, _WORD)
    out, count = viewed(port.out[_HEADER:], RECORD), 0
    for k in range(first, last):
        if frames[k].bits_on_wire != 0:
            out[count].can_id, out[count].size, out[count].data = frames[k].cob_id, frames[k].size, data[k]
            count += 1
    state.out = _HEADER + RECORD_BYTES * count
    sent = CONTINUE
    if count and send(state.descriptor, port.out.ctypes.data, state.out, MSG_DONTWAIT | MSG_NOSIGNAL) != state.out:
        sent = UNSENT
    return sent


@merged
def _take_answers(port: Port, bitrate: int) -> int:
    """Take the answers that are awaited, and what they tell; or NOTHING, OTHER."""
    outcome = _receive(port)
    if outcome == CONTINUE and not _accept(port, bitrate):
        outcome = OTHER
    if outcome == CONTINUE:
        kernel.observe(port.image, 1e9 / bitrate)
    return outcome


#: ask: send set points and SYNC of the bench; OTHER, and nothing done, where a value does not fit, it is late, or a
#: packet has come before, which is in the buffer then.
#: collect: take all answers to them.
#: answer: take the frames of a SYNC, and answer it.
#: hear: take the answers of others to the same SYNC.
@entry_point(COUNT, TABLE)
def ask(bitrate: int, table: Table) -> int:
    port = arrays_in(table, Port)
    image, state = port.image, port.state
    _await(port, state.asked, len(image.frames))
    state.taken = max(0, recv(state.descriptor, port.packets.ctypes.data, _PACKET_BYTES, MSG_DONTWAIT))
    if state.taken > 0 or _now_ns(port) > state.until_ns or not kernel.encode(image):
        return OTHER
    kernel.begin(image)
    for k in range(state.asked):
        if kernel.is_due(image.frames[k], 0):
            kernel.carry(image, k, bitrate)
    return _send(port, 0, state.asked)


@entry_point(COUNT, TABLE)
def collect(bitrate: int, table: Table) -> int:
    return _take_answers(arrays_in(table, Port), bitrate)


@entry_point(COUNT, TABLE)
def answer(bitrate: int, table: Table) -> int:
    port = arrays_in(table, Port)
    image, state = port.image, port.state
    if state.last == 0:
        _await(port, 0, state.asked)
    outcome = _receive(port)
    if outcome != CONTINUE:  # a packet without SYNC is for the host: a bench that keeps alive, say
        return OTHER if state.packets > 0 else outcome
    state.now_ns = _now_ns(port)
    if state.now_ns > state.until_ns:
        return OTHER
    kernel.begin(image)
    if not _accept(port, bitrate):
        return OTHER
    for k in range(state.asked, state.answers):
        if kernel.is_due(image.frames[k], image.clocks[0]):
            kernel.carry(image, k, bitrate)
    kernel.follow(image)
    outcome = _send(port, state.asked, state.answers)
    if state.answers < len(image.frames):
        _await(port, state.answers, len(image.frames))
    else:
        _await(port, 0, state.asked)
    return outcome


@entry_point(COUNT, TABLE)
def hear(bitrate: int, table: Table) -> int:
    port = arrays_in(table, Port)
    outcome = _take_answers(port, bitrate)
    if outcome == CONTINUE:
        _await(port, 0, port.state.asked)
    return outcome
