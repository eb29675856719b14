"""Arrays of a fast-path cycle; `tables` makes their rows from the objects of bench and devices.

A value of an object is in a *slot*: whole numbers in one vector, REAL32 and REAL64 in another. Units are SI where a
field has one in its name, else those of the device.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import record_type

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
#: When it is on the wire: with every `every`-th cycle; when the device's clock has come to `next_ns`; or at any time,
#: for one that is only received.
BY_CYCLES, BY_TIME, BY_ARRIVAL = 0, 1, 2

#: A frame that may be on the wire in a cycle.
FRAME = np.dtype(
    [
        ("cob_id", "i8"),
        ("size", "i8"),
        ("part", "i8"),
        ("timing", "i8"),
        ("clock", "i8"),  # whose time: place among those that a cycle is given
        ("every", "i8"),
        ("count", "i8"),  # cycles since it was on the wire
        ("period_ns", "i8"),
        ("next_ns", "i8"),
        ("time_ns", "i8"),  # as in the trace
        ("bits_on_wire", "i8"),  # in this cycle; 0: it was not there
        ("first_sent", "i8"),  # of the fields that are put into it
        ("last_sent", "i8"),
        ("first_received", "i8"),  # of those that are taken from it
        ("last_received", "i8"),
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
#: What a cycle is given: its start in ns, and where its text begins in that of the trace.
GIVEN = record_type("start_ns", "text", of=np.int64)
#: What it leaves: frames, bit times of all, their time on the wire in ns, frames that do not go by cycles, where its
#: text ends.
LEFT = record_type("frames", "bits", "duration_ns", "timed", "text", of=np.int64)
#: Longest line of a trace without the channel: time, identifier, eight bytes.
LINE = 64
