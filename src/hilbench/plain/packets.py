"""Packets of the embedded bus, read by the whole: identifiers, sizes and data of their frames."""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np

from hilbench.can import protocol

#: `protocol.CAN_RECORD`.
RECORD = np.dtype([("can_id", "u4"), ("size", "u1"), ("flags", "u1"), ("_", "u2"), ("data", "u1", (8,))])
_BODY = protocol.HEADER.size
_ONE = protocol.STAMPED_CAN_RECORD
_FIELDS = 5


class Packets:
    """Those that belong together, one after the other, while none of `dropped` frames more is lost on this side.

    `data`: eight octets a frame, those behind its size zero.
    """

    def __init__(self, dropped: int) -> None:
        self._header = protocol.HEADER.pack(protocol.KIND_CLASSICAL, dropped & 0xFFFFFFFF)
        self.begin()

    def begin(self) -> None:
        """Nothing has come."""
        self.all: list[bytes] = []
        self.cob_ids: tuple[int, ...] = ()
        self.sizes: tuple[int, ...] = ()
        self.data = b""

    def take(self, packet: bytes | None) -> bool:
        """One more; False where it is none, or says that frames were lost."""
        if packet is None:
            return False
        self.all.append(packet)
        if not packet.startswith(self._header):
            return False
        count = (len(packet) - _BODY) // _ONE.size
        values = _layout(count).unpack_from(packet, _BODY)
        self.cob_ids += values[::_FIELDS]
        self.sizes += values[1::_FIELDS]
        self.data += b"".join(values[3::_FIELDS])
        return True


@lru_cache(64)
def _layout(count: int) -> struct.Struct:
    """Of so many records."""
    return struct.Struct("=" + count * _ONE.format[1:])
