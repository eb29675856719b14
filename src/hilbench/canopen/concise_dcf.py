"""Concise DCF (CiA 302-3): the writes that configure a device, in one block of bytes, as 1F22h of a master holds it.

UNSIGNED32 number of entries, then each entry: UNSIGNED16 index, UNSIGNED8 sub-index, UNSIGNED32 length, the data.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

_COUNT: Final = struct.Struct("<I")
_HEAD: Final = struct.Struct("<HBI")


@dataclass(frozen=True)
class Write:
    """One object and the bytes that it gets."""

    index: int
    sub: int
    data: bytes

    @property
    def key(self) -> tuple[int, int]:
        """Index and sub-index."""
        return self.index, self.sub


def encode(writes: Iterable[Write]) -> bytes:
    """The block of these writes, in their order."""
    entries = [_HEAD.pack(write.index, write.sub, len(write.data)) + write.data for write in writes]
    return _COUNT.pack(len(entries)) + b"".join(entries)


def decode(block: bytes) -> list[Write]:
    """The writes of a block, in their order. Raises ValueError, with a text for a person, when it is no such block."""
    if len(block) < _COUNT.size:
        raise ValueError(f"{len(block)} bytes, expected a number of entries in the first {_COUNT.size}")
    (count,) = _COUNT.unpack_from(block)
    writes, at = [], _COUNT.size
    for number in range(1, count + 1):
        end = at + _HEAD.size
        if end > len(block):
            raise ValueError(f"ends in entry {number} of {count} (byte {len(block)}), expected index and length of it")
        index, sub, length = _HEAD.unpack_from(block, at)
        at = end + length
        if at > len(block):
            missing = at - len(block)
            raise ValueError(f"ends in entry {number} of {count} ({index:04X}h sub {sub}): {missing} bytes are missing")
        writes.append(Write(index, sub, block[end:at]))
    if at != len(block):
        raise ValueError(f"{len(block) - at} bytes after entry {count}, expected {count} entries and nothing else")
    return writes
