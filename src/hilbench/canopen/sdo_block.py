"""SDO block transfer, server side (CiA 301, 7.2.4.3.9 to 7.2.4.3.17): up to 127 segments per confirmation.

Both classes take requests and return the data of the answers; the caller sends them. They raise SdoAbort
when the transfer has to end.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx

from hilbench.canopen.object_store import (
    BLOCK_SIZE,
    CRC_ERROR,
    SEQUENCE_NUMBER,
    TOO_LONG,
    TOO_SHORT,
    UNKNOWN_COMMAND,
    SdoAbort,
)

_SEGMENT = 7
_MOST_SEGMENTS = 127
_LAST = 0x80  #: in a segment's first byte: no more segments
_CRC = 0x04
_SIZE = 0x02

_DOWNLOAD_INITIATED, _DOWNLOAD_BLOCK, _DOWNLOAD_ENDED = 0xA0, 0xA2, 0xA1
_UPLOAD_INITIATED, _UPLOAD_END = 0xC0, 0xC1
_END_DOWNLOAD, _ACKNOWLEDGE, _START, _END_UPLOAD = 0xC1, 0xA2, 0xA3, 0xA1


class BlockDownload:
    """Block download: data from the client."""

    def __init__(self, request: bytes) -> None:
        self.receiving = True  #: segments come, until the last one has been confirmed
        self._with_crc = bool(request[0] & _CRC)
        self._size = struct.unpack_from("<I", request, 4)[0] if request[0] & _SIZE else None
        self._multiplexer = request[1:4]
        self._data = bytearray()
        self._block: list[bytes] = []

    def initiated(self) -> bytes:
        """The answer to the request that began it."""
        return bytes((_DOWNLOAD_INITIATED | _CRC, *self._multiplexer, _MOST_SEGMENTS, 0, 0, 0))

    def segment(self, request: bytes) -> bytes | None:
        """Take a segment; at the end of a block return the confirmation, with the last segment received in order."""
        number, last = request[0] & 0x7F, bool(request[0] & _LAST)
        if number == len(self._block) + 1:
            self._block.append(request[1:])
            complete = last
        else:
            complete = False  # a segment was lost: the client repeats from the confirmed one on
        if not last and number < _MOST_SEGMENTS:
            return None
        confirmed = len(self._block)
        self._data += b"".join(self._block)
        self._block.clear()
        self.receiving = not complete
        if self._size is not None and len(self._data) > self._size + _SEGMENT - 1:
            raise SdoAbort(TOO_LONG)
        return bytes((_DOWNLOAD_BLOCK, confirmed, _MOST_SEGMENTS, 0, 0, 0, 0, 0))

    def end(self, request: bytes) -> bytes:
        """The data, when the request ends the transfer and size and checksum are right."""
        if request[0] & 0xE3 != _END_DOWNLOAD:
            raise SdoAbort(UNKNOWN_COMMAND)
        unused = request[0] >> 2 & 0x7
        data = bytes(self._data[: len(self._data) - unused])
        if self._size is not None and len(data) != self._size:
            raise SdoAbort(TOO_LONG if len(data) > self._size else TOO_SHORT)
        if self._with_crc and crc_hqx(data, 0) != struct.unpack_from("<H", request, 1)[0]:
            raise SdoAbort(CRC_ERROR)
        return data

    @staticmethod
    def ended() -> bytes:
        """The answer to the request that ended it."""
        return bytes((_DOWNLOAD_ENDED, 0, 0, 0, 0, 0, 0, 0))


class BlockUpload:
    """Block upload: data to the client."""

    def __init__(self, request: bytes, data: bytes) -> None:
        self._multiplexer = request[1:4]
        self._segments = [data[at : at + _SEGMENT] for at in range(0, len(data), _SEGMENT)]
        self._size = len(data)
        self._checksum = crc_hqx(data, 0) if request[0] & _CRC else 0
        self._confirmed = 0
        self._sent = 0
        self._ended = False
        self.done = False  #: the client has confirmed the end
        self._per_block = self._checked(request[4])

    def initiated(self) -> bytes:
        """The answer to the request that began it."""
        return bytes((_UPLOAD_INITIATED | _CRC | _SIZE, *self._multiplexer)) + struct.pack("<I", self._size)

    def handle(self, request: bytes) -> list[bytes]:
        """Answer the client's next request: a block, or the end."""
        if request[0] == _START and not self._sent:
            return self._next_block()
        if request[0] == _ACKNOWLEDGE and self._sent and not self._ended:
            if request[1] > self._sent:
                raise SdoAbort(SEQUENCE_NUMBER)
            self._confirmed += request[1]
            self._per_block = self._checked(request[2])
            return self._end() if self._confirmed == len(self._segments) else self._next_block()
        if request[0] == _END_UPLOAD and self._ended:
            self.done = True
            return []
        raise SdoAbort(UNKNOWN_COMMAND)

    def _next_block(self) -> list[bytes]:
        block = self._segments[self._confirmed : self._confirmed + self._per_block]
        self._sent = len(block)
        ends = self._confirmed + self._sent == len(self._segments)
        return [
            bytes((number | (_LAST if ends and number == self._sent else 0),)) + segment.ljust(_SEGMENT, b"\0")
            for number, segment in enumerate(block, start=1)
        ]

    def _end(self) -> list[bytes]:
        self._ended = True
        unused = _SEGMENT - len(self._segments[-1])
        return [struct.pack("<BH5x", _UPLOAD_END | unused << 2, self._checksum)]

    @staticmethod
    def _checked(segments: int) -> int:
        if not 1 <= segments <= _MOST_SEGMENTS:
            raise SdoAbort(BLOCK_SIZE)
        return segments
