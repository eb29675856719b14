"""A fast-path cycle, compiled: the work of `exchange`, `can`, `canopen.device` and `cia402.simulated`, on the arrays
of `layout`. Each function names its counterpart; any other cycle is run by those alone."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from hilbench.can.compiled_wire import bits_on_wire
from hilbench.cia402.state_machine import STATUS_INTERNAL_LIMIT
from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    floats,
    integers,
    table_of,
    viewed,
)
from hilbench.cycle_program import CONTINUE
from hilbench.exchange.measured import take_twin
from hilbench.fast_path import layout as lay
from hilbench.fast_path.layout import Bytes, Real, Row, Rows, Single, Whole

_SIGNED, _FLOAT = lay.SIGNED, lay.FLOAT
_BEFORE_SYNC, _SYNC, _BY_TIME = lay.BEFORE_SYNC, lay.SYNC, lay.BY_TIME
_I_START_NS, _I_CLOCKS, _I_TEXT = lay.I_START_NS, lay.I_CLOCKS, lay.I_TEXT
_O_FRAMES, _O_BITS, _O_DURATION_NS, _O_TEXT = lay.O_FRAMES, lay.O_BITS, lay.O_DURATION_NS, lay.O_TEXT
_O_TIMED, _O_SIZE = lay.O_TIMED, lay.O_SIZE
_PORT_SIZE = lay.PORT_SIZE
_INTERNAL_LIMIT = STATUS_INTERNAL_LIMIT
_HALF, _WRAP = 1 << 31, 1 << 32
_INT16_MAX = 0x7FFF
_LARGEST = 2.0**53  # whole numbers up to here are exact
_SECOND_NS = 1_000_000_000
_DIGITS = np.frombuffer(b"0123456789ABCDEF", np.uint8).copy()

Table = NDArray[np.int64]
_FRAME, _FIELD, _TARGET, _DRIVE, _SEEN_BY = lay.FRAME, lay.FIELD, lay.TARGET, lay.DRIVE, lay.FEEDBACK
_VIRTUAL_IO_BY = lay.VIRTUAL_IO
_OCTET, _SINGLE = np.dtype(np.uint8), np.dtype(np.float32)
# Rows of the table: as `vectors` has them.
(
    _TARGETS,
    _ASKING,
    _FRAMES,
    _SENT,
    _RECEIVED,
    _DRIVES,
    _SEEN,
    _WHOLE,
    _REAL,
    _GIVEN,
    _LEFT,
    _DATA,
    _HEADS,
    _TEXT,
    _SCRATCH,
    _FEEDBACK,
    _ASKED,
    _SHOWN,
    _VIRTUAL_IO_ROWS,
    _CAME,
    _TORQUES,
    _BEFORE_NM,
    _OF_DRIVES,
    _VIRTUAL_IO,
) = range(24)
#: What `exchange` and `publish` return where nothing was done: a value does not fit, a fault would follow.
DOES_NOT_FIT = FAULT = 1


#: What is not given.
_NOTHING = np.zeros(0, np.int64)


@dataclass(frozen=True, kw_only=True)
class Vectors:
    """Arrays of a fast-path cycle, in the order of the table: rows of `layout`, values, bytes. One not given
    is empty: no work."""

    targets: Rows | None = None
    set_points: Real | None = None  #: by target
    frames: Rows
    sent: Rows | None = None  #: fields
    received: Rows | None = None
    drives: Rows | None = None
    seen: Rows | None = None
    whole: Whole
    real: Real
    given: Whole
    left: Whole
    data: Bytes  #: (8 F,)
    heads: Bytes | None = None  #: of the trace's lines
    text: Bytes | None = None  #: of length 0: no trace
    scratch: Bytes = field(default_factory=lambda: np.zeros(8, np.uint8))
    feedback: Real | None = None
    asked: Real | None = None  #: set points that the drives follow
    shown: Real | None = None  #: by their ports
    virtual_io_rows: Rows | None = None
    came: Whole | None = None  #: this and what follows: as of `exchange.measured`
    torques: Whole | None = None
    before_Nm: Real | None = None
    of_drives: Real | None = None
    virtual_io: Real | None = None

    def table(self) -> Table:
        """Table of the arrays' addresses; they are to be kept. Lengths in bytes are multiples of eight."""
        given = [_NOTHING if vector is None else vector for vector in (getattr(self, f.name) for f in fields(self))]
        return table_of([each if each.dtype == np.float64 else each.view(np.int64) for each in given])


@compiled
def _wrap(value: int) -> int:
    """`cia402.units.wrap_int32`."""
    return (value + _HALF) % _WRAP - _HALF


@compiled
def _fits(field: Row, whole: Whole, real: Real, single: Single) -> bool:
    """True if `canopen.pdo.PdoMap.pack` takes the value of a field."""
    if field.kind == _FLOAT:
        if field.width == 8:
            return True
        single[0] = real[field.slot]
        return bool(np.isfinite(single[0])) or not np.isfinite(real[field.slot])
    if field.width == 8:
        return True
    low = -(1 << (8 * field.width - 1)) if field.kind == _SIGNED else 0
    return bool(low <= whole[field.slot] < low + (1 << 8 * field.width))


@compiled
def _all_fit(fields: Rows, whole: Whole, real: Real, single: Single) -> bool:
    """True if the values of all fields sent fit."""
    misfits = 0
    for k in range(len(fields)):
        misfits += not _fits(fields[k], whole, real, single)
    return misfits == 0


@compiled
def _put(field: Row, whole: Whole, real: Real, scratch: Bytes, single: Single, double: Real, data: Bytes) -> None:
    """`canopen.pdo.PdoMap.pack` of one value that fits; `scratch`: the bytes of `single` and `double`."""
    slot, at, width = field.slot, field.offset, field.width
    if field.kind == _FLOAT:
        if width == 4:
            single[0] = real[slot]
        else:
            double[0] = real[slot]
        for k in range(width):
            data[at + k] = scratch[k]
        return
    for k in range(width):
        data[at + k] = whole[slot] >> 8 * k & 0xFF


@compiled
def _get(field: Row, whole: Whole, real: Real, scratch: Bytes, single: Single, double: Real, data: Bytes) -> None:
    """`canopen.pdo.PdoMap.unpack` of one value."""
    slot, at, width = field.slot, field.offset, field.width
    if field.kind == _FLOAT:
        for k in range(width):
            scratch[k] = data[at + k]
        real[slot] = single[0] if width == 4 else double[0]
        return
    number = np.int64(0)
    for k in range(width):
        number |= np.int64(data[at + k]) << 8 * k
    if field.kind == _SIGNED and width < 8 and number >> (8 * width - 1):
        number -= np.int64(1) << 8 * width
    whole[slot] = number


@compiled
def trace_line(frame: Row, heads: Bytes, data: Bytes, text: Bytes, at: int) -> int:
    """`results.trace.TraceWriter.write` of one frame at `at`; returns where the next one begins."""
    seconds, rest_ns = frame.time_ns // _SECOND_NS, frame.time_ns % _SECOND_NS
    text[at] = 0x28
    digits, rest = 1, seconds
    while rest >= 10:
        rest //= 10
        digits += 1
    for k in range(digits):
        text[at + digits - k] = 0x30 + seconds % 10
        seconds //= 10
    at += digits + 1
    text[at] = 0x2E
    rest = rest_ns // 1000
    for k in range(6):
        text[at + 6 - k] = 0x30 + rest % 10
        rest //= 10
    at += 7
    for k in range(frame.head, frame.head_end):
        text[at] = heads[k]
        at += 1
    for k in range(frame.size):
        text[at] = _DIGITS[data[k] >> 4]
        text[at + 1] = _DIGITS[data[k] & 0xF]
        at += 2
    text[at] = 0x0A
    return at + 1


@compiled
def _is_due(frame: Row, now_ns: int) -> bool:
    """`canopen.device_pdo.Tpdo.sync` and `canopen.heartbeat.HeartbeatProducer.due`."""
    if frame.timing == _BY_TIME:
        if now_ns < frame.next_ns:
            return False
        frame.next_ns = max(frame.next_ns + frame.period_ns, now_ns)
        return True
    frame.count += 1
    if frame.count < frame.every:
        return False
    frame.count = 0
    return True


@compiled
def _set_times(frames: Rows, bits_of: Whole, start_ns: int, bit_ns: float) -> None:
    """`exchange.sync_cycle.SyncCycle` with the times of frames on a wire that starts each cycle with its SYNC."""
    before, sync = 0, 0
    for k in range(len(frames)):
        if frames[k].part == _BEFORE_SYNC:
            before += bits_of[k]
        elif frames[k].part == _SYNC:
            sync += bits_of[k]
    part, base_ns, at_bits = _BEFORE_SYNC, start_ns - int(before * bit_ns), 0
    for k in range(len(frames)):
        frame = frames[k]
        if not bits_of[k]:
            continue
        if frame.part != part:
            part, at_bits = frame.part, 0
            base_ns = start_ns if part == _SYNC else start_ns + int(sync * bit_ns)
        at_bits += bits_of[k]
        frame.time_ns = base_ns + int(at_bits * bit_ns)


@compiled
def _see(seen: Row, whole: Whole, feedback: Real) -> None:
    """`cia402.drive.Drive` with its feedback: position, velocity, torque, statusword."""
    reading = whole[seen.position]
    seen.value += _wrap(reading - seen.last)
    seen.last = reading
    position_rad = seen.value * seen.position_rad
    if seen.by_difference:
        feedback[1] = (position_rad - seen.before_rad) / seen.period_s
    else:
        feedback[1] = whole[seen.speed] * seen.velocity_rad_s if seen.speed >= 0 else 0.0
    seen.before_rad = feedback[0] = position_rad
    feedback[2] = whole[seen.torque] * seen.torque_Nm
    feedback[3] = whole[seen.statusword]


@compiled
def _hear(rows: Rows, bits_of: Whole, real: Real, came: Whole, virtual_io: Real) -> None:
    """`exchange.nodes.Nodes` with what the twin's TPDOs bring."""
    for k in range(len(rows)):
        row = rows[k]
        came[k] = bits_of[row.frame] != 0
        if came[k]:
            for slot in range(row.first, row.last):
                virtual_io[row.place + slot - row.first] = real[slot]


@compiled
def _follow(drive: Row, whole: Whole) -> None:
    """`cia402.modes.CyclicSynchronousVelocity` and `CyclicSynchronousTorque` with their set point."""
    set_point = (whole[drive.target] + whole[drive.offset]) * drive.set_point_unit
    drive.limited = not (-drive.limit <= set_point <= drive.limit)
    drive.set_point = max(-drive.limit, min(drive.limit, set_point)) if drive.limited else set_point


@compiled
def _encode(targets: Rows, sent: Rows, set_points: Real, whole: Whole, real: Real, single: Single) -> bool:
    """`exchange.nodes.Nodes.encode`: raw set points into their slots; False where one does not fit, or another value
    that is to be sent does not."""
    for k in range(len(targets)):
        target = targets[k]
        if target.source < 0:
            value = set_points[k] / target.unit
        elif target.factor == 1.0:
            value = float(whole[target.source])
        else:
            value = whole[target.source] * target.factor
        number = np.rint(value)
        if not -target.most <= number <= target.most:
            return False
        whole[target.slot] = int(number)
    return _all_fit(sent, whole, real, single)


#: exchange(bitrate, table of `Vectors`): the frames of a cycle over the wire; DOES_NOT_FIT, and nothing done, where a
#: value does not.
#: publish(0, table): feedback into the objects; FAULT, and nothing done, where one would follow.
@entry_point(COUNT, TABLE)
def exchange(bitrate: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    targets, frames = (
        viewed(integers(table, _TARGETS, (1,)), _TARGET),
        viewed(integers(table, _FRAMES, (1,)), _FRAME),
    )
    sent, received = viewed(integers(table, _SENT, (1,)), _FIELD), viewed(integers(table, _RECEIVED, (1,)), _FIELD)
    drives, seen = viewed(integers(table, _DRIVES, (1,)), _DRIVE), viewed(integers(table, _SEEN, (1,)), _SEEN_BY)
    whole, real, set_points = (
        integers(table, _WHOLE, (1,)),
        floats(table, _REAL, (1,)),
        floats(table, _ASKING, (1,)),
    )
    given, left = integers(table, _GIVEN, (1,)), integers(table, _LEFT, (1,))
    data, heads = viewed(integers(table, _DATA, (1,)), _OCTET), viewed(integers(table, _HEADS, (1,)), _OCTET)
    text, scratch = viewed(integers(table, _TEXT, (1,)), _OCTET), viewed(integers(table, _SCRATCH, (1,)), _OCTET)
    single, double = viewed(scratch, _SINGLE), floats(table, _SCRATCH, (1,))
    feedback, asked = floats(table, _FEEDBACK, (1,)), floats(table, _ASKED, (1,))
    if not _encode(targets, sent, set_points, whole, real, single):
        return DOES_NOT_FIT
    bits_of = left[_O_SIZE:]
    left[:] = 0
    taken = 0
    for k in range(len(frames)):
        frame = frames[k]
        if not _is_due(frame, given[_I_CLOCKS + frame.clock]):
            continue
        octets = data[8 * k : 8 * k + 8]
        for at in range(frame.first, frame.last):
            _put(sent[at], whole, real, scratch, single, double, octets)
        while taken < len(received) and received[taken].frame <= k:
            if received[taken].frame == k:
                _get(received[taken], whole, real, scratch, single, double, octets)
            taken += 1
        bits = bits_on_wire(frame.crc, frame.stuffing, frame.bits, octets, frame.size)
        bits_of[k] = bits
        left[_O_FRAMES] += 1
        left[_O_BITS] += bits
        left[_O_DURATION_NS] += bits * _SECOND_NS // bitrate
        left[_O_TIMED] += frame.timing == _BY_TIME
    for k in range(len(drives)):
        _follow(drives[k], whole)
        asked[k] = drives[k].set_point
    for k in range(len(seen)):
        _see(seen[k], whole, feedback[4 * k : 4 * k + 4])
    of_drives, virtual_io, came = (
        floats(table, _OF_DRIVES, (1,)),
        floats(table, _VIRTUAL_IO, (1,)),
        integers(table, _CAME, (1,)),
    )
    for k in range(len(of_drives)):  # with slices numba would have a text ready for two of unequal length
        of_drives[k] = feedback[k]
    _hear(viewed(integers(table, _VIRTUAL_IO_ROWS, (1,)), _VIRTUAL_IO_BY), bits_of, real, came, virtual_io)
    take_twin(came, integers(table, _TORQUES, (1,)), floats(table, _BEFORE_NM, (1,)), of_drives, virtual_io)
    _set_times(frames, bits_of, given[_I_START_NS], 1e9 / bitrate)
    if len(text) > 0:
        at = given[_I_TEXT]
        for k in range(len(frames)):
            if bits_of[k]:
                at = trace_line(frames[k], heads, data[8 * k : 8 * k + 8], text, at)
        left[_O_TEXT] = at
    return CONTINUE


@entry_point(COUNT, TABLE)
def publish(_: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    drives = viewed(integers(table, _DRIVES, (1,)), _DRIVE)
    ports, whole = floats(table, _SHOWN, (1,)), integers(table, _WHOLE, (1,))
    for k in range(len(drives)):
        drive, port = drives[k], ports[k * _PORT_SIZE : (k + 1) * _PORT_SIZE]
        if not abs(port[1]) <= drive.overspeed_rad_s:
            return FAULT
        unit = drive.velocity_rad_s if drive.velocity else drive.torque_Nm
        largest = abs(port[0] / drive.position_rad)
        largest = max(largest, abs(port[1] / drive.velocity_rad_s), abs(port[1] / drive.vl_rad_s))
        largest = max(largest, abs(port[2] / drive.torque_Nm), abs(port[3] / unit))
        if not largest < _LARGEST:
            return FAULT
    for k in range(len(drives)):
        _show(drives[k], ports[k * _PORT_SIZE : (k + 1) * _PORT_SIZE], whole)
    return CONTINUE


@compiled
def _show(drive: Row, port: Real, whole: Whole) -> None:
    """`cia402.firmware.Firmware.show`, and the statusword of a drive that follows."""
    drive.count = int(np.rint(port[0] / drive.position_rad))
    position = _wrap(drive.count + drive.origin)
    whole[drive.position] = position
    whole[drive.speed] = _wrap(int(np.rint(port[1] / drive.velocity_rad_s)))
    torque = int(np.rint(port[2] / drive.torque_Nm))
    whole[drive.torque] = int(max(-_INT16_MAX, min(_INT16_MAX, torque)))
    if drive.vl >= 0:
        speed = int(np.rint(port[1] / drive.vl_rad_s))
        whole[drive.vl] = int(max(-_INT16_MAX, min(_INT16_MAX, speed)))
    if drive.velocity:
        whole[drive.velocity_demand] = _wrap(int(np.rint(port[3] / drive.velocity_rad_s)))
    else:
        whole[drive.torque_demand] = int(np.rint(port[3] / drive.torque_Nm))
    whole[drive.position_demand] = position
    bits = drive.bits
    if drive.limited or port[4] != 0.0:
        bits |= _INTERNAL_LIMIT
    whole[drive.statusword] = bits


def warm_up() -> None:
    """Compile, or load from the cache, before a cycle has to wait for it."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    exchange(1_000_000, nothing)
    publish(0, nothing)
