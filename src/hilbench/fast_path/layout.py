"""Arrays of a fast-path cycle; `tables` makes their rows from the objects of bench and devices.

A value of an object is in a *slot*: whole numbers in one vector, REAL32 and REAL64 in another. Units are SI where a
field has one in its name, else those of the device.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[Any]  #: of one of the types below
Row = Any  #: one of these
Whole = NDArray[np.int64]
Real = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Single = NDArray[np.float32]

#: What a value is in a PDO.
UNSIGNED, SIGNED, FLOAT = 0, 1, 2
#: Place of a frame in a cycle: sent by the bench before SYNC, SYNC, or an answer.
BEFORE_SYNC, SYNC, ANSWER = 0, 1, 2
#: When it is sent: with every `every`-th cycle, or when the device's clock has come to `next_ns`.
BY_CYCLES, BY_TIME = 0, 1

#: A frame that may be sent in a cycle, in the order of the wire.
FRAME = np.dtype(
    [
        ("size", "i8"),
        ("part", "i8"),
        ("timing", "i8"),
        ("clock", "i8"),  # whose time: place among those that a cycle is given
        ("every", "i8"),
        ("count", "i8"),  # cycles since it was sent
        ("period_ns", "i8"),
        ("next_ns", "i8"),
        ("time_ns", "i8"),  # as in the trace
        ("first", "i8"),  # of its fields
        ("last", "i8"),
        ("crc", "i8"),  # as `can.wire.header` has them
        ("stuffing", "i8"),
        ("bits", "i8"),
        ("head", "i8"),  # of its text between time and data
        ("head_end", "i8"),
    ]
)
#: A value in a frame.
FIELD = np.dtype([("frame", "i8"), ("slot", "i8"), ("offset", "i8"), ("width", "i8"), ("kind", "i8")])
#: A set point on its way into an RPDO. `factor`: of a copy's unit.
TARGET = np.dtype([("unit", "f8"), ("most", "i8"), ("slot", "i8"), ("source", "i8"), ("factor", "f8")])
#: A simulated drive that follows its set point (`cia402.simulated.SimulatedDrive.follows`). Slots of objects that its
#: device lacks are -1.
DRIVE = np.dtype(
    [
        ("velocity", "i8"),  # 1: follows a velocity, 0: a torque
        ("target", "i8"),
        ("offset", "i8"),
        ("set_point_unit", "f8"),
        ("limit", "f8"),
        ("set_point", "f8"),
        ("limited", "i8"),
        ("position_rad", "f8"),  # of one unit, as the next
        ("velocity_rad_s", "f8"),
        ("torque_Nm", "f8"),
        ("vl_rad_s", "f8"),
        ("overspeed_rad_s", "f8"),
        ("origin", "i8"),
        ("count", "i8"),
        ("position", "i8"),
        ("speed", "i8"),
        ("torque", "i8"),
        ("vl", "i8"),
        ("position_demand", "i8"),
        ("velocity_demand", "i8"),
        ("torque_demand", "i8"),
        ("statusword", "i8"),
        ("bits", "i8"),
    ]
)
#: A drive as the bench sees it: slots of what its TPDOs bring, its counter, and its units.
FEEDBACK = np.dtype(
    [
        ("position", "i8"),
        ("speed", "i8"),
        ("torque", "i8"),
        ("statusword", "i8"),
        ("value", "i8"),
        ("last", "i8"),
        ("position_rad", "f8"),
        ("velocity_rad_s", "f8"),
        ("torque_Nm", "f8"),
        ("before_rad", "f8"),
        ("period_s", "f8"),
        ("by_difference", "i8"),  # 1: its velocity is the difference of its positions
    ]
)
#: Source of values from a TPDO of the virtual I/O: its frame, its slots among the real ones, and the first place
#: in the twin's signals (`exchange.measured`).
VIRTUAL_IO = np.dtype([("frame", "i8"), ("first", "i8"), ("last", "i8"), ("place", "i8")])
#: Values of a port in addition to its mode: position, velocity, torque, reference, torque-limited flag.
PORT_SIZE = 5
#: Whole numbers that a cycle takes: start in ns, then the time after SYNC by the clock of each host, in ns; where its
#: text begins in that of the trace.
I_START_NS, I_CLOCKS, I_TEXT, I_SIZE = 0, 1, 3, 4
#: Whole numbers that a cycle leaves: frames, bit times of all, their time on the wire in ns, where its text ends,
#: frames that go by time; then of each frame its bit times, 0 where it was not sent.
O_FRAMES, O_BITS, O_DURATION_NS, O_TEXT, O_TIMED, O_SIZE = 0, 1, 2, 3, 4, 5
#: Longest line of a trace without the channel: time, identifier, eight bytes.
LINE = 64
