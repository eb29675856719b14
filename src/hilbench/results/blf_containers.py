"""How much the packed parts of a BLF trace unpack to, looked at before a reader holds all of one in memory."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import Final

from hilbench.errors import UnusableInputError

#: Of one container, at most; writers begin a new one at 128 kB.
_MOST_BYTES: Final = 100_000_000
#: Where the size of the file's header stands, and the head of an object: signature, size with the head, type.
_HEADER_SIZE: Final = struct.Struct("<4sL")
_OBJECT: Final = struct.Struct("<4sHHLL")
_CONTAINER: Final = 10
#: What a container has before its data: method (2: zlib) and its own word on the size.
_CONTAINER_HEAD: Final = struct.Struct("<H6xL4x")
_ZLIB: Final = 2


def check_containers(path: Path) -> None:
    """Raise UnusableInputError for a container that is too large when unpacked; what else is wrong a reader says."""
    with open(path, "rb") as file:
        head = file.read(_HEADER_SIZE.size)
        if len(head) < _HEADER_SIZE.size:
            return
        file.seek(_HEADER_SIZE.unpack(head)[1])
        while len(head := file.read(_OBJECT.size)) == _OBJECT.size:
            signature, _, _, size, kind = _OBJECT.unpack(head)
            left = size - _OBJECT.size
            if signature != b"LOBJ" or left < 0:
                return
            if kind == _CONTAINER:
                _check(file.read(left), path)
            else:
                file.seek(left, os.SEEK_CUR)
            file.seek(size % 4, os.SEEK_CUR)


def _check(container: bytes, path: Path) -> None:
    if len(container) < _CONTAINER_HEAD.size or _CONTAINER_HEAD.unpack_from(container)[0] != _ZLIB:
        return
    try:
        unpacked = zlib.decompressobj().decompress(container[_CONTAINER_HEAD.size :], _MOST_BYTES + 1)
    except zlib.error:
        return
    if len(unpacked) > _MOST_BYTES:
        raise UnusableInputError(
            path, f"a container of more than {_MOST_BYTES / 1e6:g} MB when unpacked, expected at most that"
        )
