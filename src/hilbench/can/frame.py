"""The CAN frame of the cyclic path: a light tuple, and the kernel's ``struct can_frame`` layout; the arbitration
field's order on the wire (ISO 11898-1, 10.4.2), and acceptance filters."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
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


@lru_cache(4096)
def priority(can_id: int) -> int:
    """The bits of the arbitration field as a number: the lowest wins, as dominant (0) bits win on the wire.

    Base format: identifier, RTR, IDE (0). Extended format: the identifier's high 11 bits, SRR (1), IDE (1), its low
    18 bits, RTR. So a base frame beats an extended one with the same first 11 bits, and data beat a remote request.
    """
    remote = 1 if can_id & REMOTE_FLAG else 0
    if can_id & EXTENDED_FLAG:
        return (can_id >> 18 & 0x7FF) << 21 | 0b11 << 19 | (can_id & 0x3FFFF) << 1 | remote
    return (can_id & 0x7FF) << 21 | remote << 20


def accepts(filters: Sequence[tuple[int, int]] | None, can_id: int) -> bool:
    """True if one of the (identifier, mask) filters lets `can_id` (with its flag bits) pass; None lets all pass."""
    return filters is None or any((can_id ^ identifier) & mask == 0 for identifier, mask in filters)
