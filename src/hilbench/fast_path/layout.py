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

#: A frame that may be on the wire in a cycle: of a device with `clock` (place among those that a cycle is given);
#: `count`: cycles since it was on the wire; `time_ns`: as in the trace; `bits_on_wire` in this cycle, 0: it was not
#: there; fields that are put into it, and taken from it; `crc`, `stuffing`, `bits`: as `can.wire.header` has them;
#: `head`: of its text between time and data.
FRAME = record_type(
    *("cob_id", "size", "part", "timing", "clock", "every", "count", "period_ns", "next_ns", "time_ns", "bits_on_wire"),
    *("first_sent", "last_sent", "first_received", "last_received", "crc", "stuffing", "bits", "head", "head_end"),
    of=np.int64,
)
#: A value in a frame.
FIELD = np.dtype([("frame", "i8"), ("slot", "i8"), ("offset", "i8"), ("width", "i8"), ("kind", "i8")])
#: A set point on its way into an RPDO. `factor`: of a copy's unit.
TARGET = np.dtype([("unit", "f8"), ("most", "i8"), ("slot", "i8"), ("source", "i8"), ("factor", "f8")])
#: A simulated drive that follows its set point (`cia402.simulated.SimulatedDrive.follows`), a `velocity` or a torque.
#: Slots of objects that its device lacks are -1; `position_rad` and the three behind it: of one unit.
_OF_DRIVE = record_type(
    *("velocity", "target", "offset", "limited", "origin", "count", "position", "speed", "torque", "vl"),
    *("position_demand", "velocity_demand", "torque_demand", "statusword", "bits"),
    of=np.int64,
)
_UNITS = record_type(
    *("set_point_unit", "limit", "set_point", "position_rad", "velocity_rad_s", "torque_Nm", "vl_rad_s"),
    "overspeed_rad_s",
)
DRIVE = np.dtype([*_OF_DRIVE.descr, *_UNITS.descr])
#: A drive as the bench sees it: slots of what its TPDOs bring, its counter, its units, and whether its velocity is the
#: difference of its positions.
_SLOTS = record_type("position", "speed", "torque", "statusword", "value", "last", "by_difference", of=np.int64)
_SEEN = record_type("position_rad", "velocity_rad_s", "torque_Nm", "before_rad", "period_s")
FEEDBACK = np.dtype([*_SLOTS.descr, *_SEEN.descr])
#: Source of values from a TPDO of the virtual I/O: its frame, its slots among the real ones, and the first place
#: in the twin's signals (`exchange.measured`).
VIRTUAL_IO = np.dtype([("frame", "i8"), ("first", "i8"), ("last", "i8"), ("place", "i8")])
#: What a cycle is given: its start in ns, and where its text begins in that of the trace.
GIVEN = record_type("start_ns", "text", of=np.int64)
#: What it leaves: frames, bit times of all, their time on the wire in ns, frames that do not go by cycles, where its
#: text ends.
LEFT = record_type("frames", "bits", "duration_ns", "timed", "text", of=np.int64)
#: Longest line of a trace without the channel: time, identifier, eight bytes.
LINE = 64
