"""A fast-path cycle, compiled: the work of `exchange`, `can`, `canopen.device` and `cia402.simulated`, on the arrays
of `layout`. Each function names its counterpart; any other cycle is run by those alone."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.can.compiled_wire import OCTET, bits_on_wire
from hilbench.cia402.state_machine import STATUS_INTERNAL_LIMIT
from hilbench.cia402.units import wrap_int32
from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Table,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    merged,
    records,
    viewed,
)
from hilbench.cycle_program import CONTINUE
from hilbench.exchange.measured import FromTwin, take_twin
from hilbench.fast_path import layout as lay
from hilbench.fast_path.layout import Bytes, Real, Row, Rows, Single, Whole
from hilbench.plant.motor_port import FEEDBACK_SIZE

_SIGNED, _FLOAT = lay.SIGNED, lay.FLOAT
_BEFORE_SYNC, _SYNC, _BY_TIME, _BY_CYCLES = lay.BEFORE_SYNC, lay.SYNC, lay.BY_TIME, lay.BY_CYCLES
_INTERNAL_LIMIT = STATUS_INTERNAL_LIMIT
_INT16_MAX = 0x7FFF
_LARGEST = 2.0**53  # whole numbers up to here are exact
_SECOND_NS = 1_000_000_000
_DIGITS = np.frombuffer(b"0123456789ABCDEF", np.uint8).copy()

_SINGLE = np.dtype(np.float32)
#: What `exchange` and `publish` return where nothing was done: a value does not fit, a fault would follow.
DOES_NOT_FIT = FAULT = 1


class Image(NamedTuple):
    """Process image of the fast path in a process: frames with their data, the values in them, drives, measurements.
    What has no elements is no work."""

    frames: Annotated[Any, records(lay.FRAME)]
    sent: Annotated[Any, records(lay.FIELD)]
    received: Annotated[Any, records(lay.FIELD)]
    data: Annotated[Any, records(OCTET)]  #: (8 F,)
    order: Wholes  #: rows of the frames of this cycle, in the order of the wire
    whole: Wholes
    real: Reals
    given: Annotated[Any, lay.GIVEN]
    left: Annotated[Any, lay.LEFT]
    clocks: Wholes  #: time after SYNC of each host, ns
    scratch: Reals  #: (1,)
    heads: Annotated[Any, records(OCTET)]  #: of the trace's lines
    text: Annotated[Any, records(OCTET)]  #: of length 0: no trace
    targets: Annotated[Any, records(lay.TARGET)] = np.zeros(0, lay.TARGET)
    set_points: Reals = np.zeros(0)  #: by target
    drives: Annotated[Any, records(lay.DRIVE)] = np.zeros(0, lay.DRIVE)
    asked: Reals = np.zeros(0)  #: set points that the drives follow
    shown: Reals = np.zeros(0)  #: by their ports
    seen: Annotated[Any, records(lay.FEEDBACK)] = np.zeros(0, lay.FEEDBACK)
    feedback: Reals = np.zeros(0)
    virtual_io_rows: Annotated[Any, records(lay.VIRTUAL_IO)] = np.zeros(0, lay.VIRTUAL_IO)
    from_twin: FromTwin = FromTwin()


_wrap = compiled(wrap_int32)


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
def is_due(frame: Row, now_ns: int) -> bool:
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


@merged
def begin(image: Image) -> None:
    """Begin a cycle: no frame is on the wire yet."""
    left = image.left
    left.frames = left.bits = left.duration_ns = left.timed = 0
    for k in range(len(image.frames)):
        image.frames[k].bits_on_wire = 0


@merged
def carry(image: Image, k: int, bitrate: int) -> None:
    """Put a frame on the wire: `canopen.pdo.PdoMap.pack`, `can.wire.bits_on_wire`, `canopen.pdo.PdoMap.unpack`."""
    frame, left, octets = image.frames[k], image.left, image.data[8 * k : 8 * k + 8]
    double, scratch = image.scratch, viewed(image.scratch, OCTET)
    single = viewed(image.scratch, _SINGLE)
    for at in range(frame.first_sent, frame.last_sent):
        _put(image.sent[at], image.whole, image.real, scratch, single, double, octets)
    for at in range(frame.first_received, frame.last_received):
        _get(image.received[at], image.whole, image.real, scratch, single, double, octets)
    bits = bits_on_wire(frame.crc, frame.stuffing, frame.bits, octets, frame.size)
    frame.bits_on_wire = bits
    image.order[left.frames] = k
    left.frames += 1
    left.bits += bits
    left.duration_ns += bits * _SECOND_NS // bitrate
    left.timed += frame.timing != _BY_CYCLES


@compiled
def _set_times(frames: Rows, order: Whole, start_ns: int, bit_ns: float) -> None:
    """`exchange.sync_cycle.SyncCycle` with the times of frames on a wire that starts each cycle with its SYNC."""
    before, sync = 0, 0
    for at in range(len(order)):
        frame = frames[order[at]]
        if frame.part == _BEFORE_SYNC:
            before += frame.bits_on_wire
        elif frame.part == _SYNC:
            sync += frame.bits_on_wire
    part, base_ns, at_bits = _BEFORE_SYNC, start_ns - int(before * bit_ns), 0
    for at in range(len(order)):
        frame = frames[order[at]]
        if frame.part != part:
            part, at_bits = frame.part, 0
            base_ns = start_ns if part == _SYNC else start_ns + int(sync * bit_ns)
        at_bits += frame.bits_on_wire
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
def _hear(rows: Rows, frames: Rows, real: Real, came: Whole, virtual_io: Real) -> None:
    """`exchange.nodes.Nodes` with what the twin's TPDOs bring."""
    for k in range(len(rows)):
        row = rows[k]
        came[k] = frames[row.frame].bits_on_wire != 0
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
def encode(image: Image) -> bool:
    """`exchange.nodes.Nodes.encode`: raw set points into their slots; False where one does not fit, or another value
    that is to be sent does not."""
    targets, set_points, whole = image.targets, image.set_points, image.whole
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
    return _all_fit(image.sent, whole, image.real, viewed(image.scratch, _SINGLE))


@merged
def follow(image: Image) -> None:
    """Let the simulated drives take their set points."""
    for k in range(len(image.drives)):
        _follow(image.drives[k], image.whole)
        image.asked[k] = image.drives[k].set_point


@merged
def observe(image: Image, bit_ns: float) -> None:
    """Take the feedback of the drives and what the twin's TPDOs bring, and write the frames' lines of the trace."""
    frames, left, text, twin = image.frames, image.left, image.text, image.from_twin
    order, data, at = image.order[: left.frames], image.data, image.given.text
    for k in range(len(image.seen)):
        _see(image.seen[k], image.whole, image.feedback[4 * k : 4 * k + 4])
    for k in range(len(twin.of_drives)):  # with slices numba would have a text ready for two of unequal length
        twin.of_drives[k] = image.feedback[k]
    _hear(image.virtual_io_rows, frames, image.real, twin.came, twin.virtual_io)
    take_twin(twin)
    _set_times(frames, order, image.given.start_ns, bit_ns)
    if len(text) > 0:
        for k in order:
            at = trace_line(frames[k], image.heads, data[8 * k : 8 * k + 8], text, at)
        left.text = at


#: exchange(bitrate, table of an `Image`): the frames of a cycle over the wire, in the order of their rows;
#: DOES_NOT_FIT, and nothing done, where a value does not.
#: publish(0, table): feedback into the objects; FAULT, and nothing done, where one would follow.
@entry_point(COUNT, TABLE)
def exchange(bitrate: int, table: Table) -> int:
    image = arrays_in(table, Image)
    if not encode(image):
        return DOES_NOT_FIT
    begin(image)
    for k in range(len(image.frames)):
        if is_due(image.frames[k], image.clocks[image.frames[k].clock]):
            carry(image, k, bitrate)
    follow(image)
    observe(image, 1e9 / bitrate)
    return CONTINUE


@entry_point(COUNT, TABLE)
def publish(_: int, table: Table) -> int:
    image = arrays_in(table, Image)
    drives, ports, whole = image.drives, image.shown, image.whole
    for k in range(len(drives)):
        drive, port = drives[k], ports[k * FEEDBACK_SIZE : (k + 1) * FEEDBACK_SIZE]
        if not abs(port[1]) <= drive.overspeed_rad_s:
            return FAULT
        unit = drive.velocity_rad_s if drive.velocity else drive.torque_Nm
        largest = abs(port[0] / drive.position_rad)
        largest = max(largest, abs(port[1] / drive.velocity_rad_s), abs(port[1] / drive.vl_rad_s))
        largest = max(largest, abs(port[2] / drive.torque_Nm), abs(port[3] / unit))
        if not largest < _LARGEST:
            return FAULT
    for k in range(len(drives)):
        _show(drives[k], ports[k * FEEDBACK_SIZE : (k + 1) * FEEDBACK_SIZE], whole)
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
