"""The CAN frame of the cyclic path: a light tuple, and the kernel's ``struct can_frame`` layout."""

from __future__ import annotations

from typing import NamedTuple

#: Flag bits of ``can_id`` as in <linux/can.h>.
EXTENDED_FLAG = 0x80000000
REMOTE_FLAG = 0x40000000
ERROR_FLAG = 0x20000000


class Frame(NamedTuple):
    """One classical CAN frame.

    `can_id` carries the identifier and the kernel's flag bits (`EXTENDED_FLAG`, `REMOTE_FLAG`,
    `ERROR_FLAG`); a remote frame's `data` are dlc zero bytes. `time_ns` is the time of reception
    (CLOCK_REALTIME, or the emulated bus' own time), 0 for a frame to be sent.
    """

    can_id: int
    data: bytes
    time_ns: int = 0


def is_classical(can_id: int, length: int) -> bool:
    """True if a classical frame with `length` data bytes and this `can_id` could be on a wire."""
    return length <= 8 and not can_id & ERROR_FLAG and not (can_id & 0x1FFFF800 and not can_id & EXTENDED_FLAG)
