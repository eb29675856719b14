"""Frames on the wire for compiled callers: records of the embedded bus; `wire.bits_on_wire`, with the same tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.can import wire
from hilbench.compiled import compiled

OCTET = np.dtype(np.uint8)
#: `protocol.CAN_RECORD` and `protocol.STAMPED_CAN_RECORD`, with the data in one number.
RECORD = np.dtype([("can_id", "u4"), ("size", "u1"), ("flags", "u1"), ("padding", "u2"), ("data", "u8")])
STAMPED = np.dtype([*RECORD.descr, ("time_ns", "i8")])
RECORD_BYTES, STAMPED_BYTES = RECORD.itemsize, STAMPED.itemsize

_STUFF = np.array(wire.STUFF, np.int64)
_STUFF_LAST_7 = np.array(wire.STUFF_LAST_7, np.int64)
_CRC = np.array(wire.CRC_OF_PLACES, np.int64)


@compiled
def bits_on_wire(crc: int, state: int, bits: int, data: NDArray[np.uint8], size: int) -> int:
    """Bit times of a frame with the first `size` bytes of `data`; `crc`, `state` and `bits`: its `wire.header`."""
    for at in range(size):
        byte = data[at]
        crc ^= _CRC[8 - size + at, byte]
        entry = _STUFF[state | byte]
        state = entry & 0x700
        bits += entry >> 11
    entry = _STUFF[state | crc >> 7]
    return int(bits + (entry >> 11) + _STUFF_LAST_7[(entry & 0x700) >> 1 | crc & 0x7F])
