"""SDO server of a device: canopen's, on the device's object store, with its answers corrected.

Added to canopen's server (2.4.1): refusals that name the object they refuse, an end to every
transfer (after its last segment, an abort of either side), the announced size checked, block transfer, and errors of
the application that are raised instead of becoming an abort code.

Block transfer (CiA 301, 7.2.4.3.9 to 7.2.4.3.17) has up to 127 segments per confirmation; its classes take requests and
return the data of the answers. They raise SdoAbort when the transfer has to end.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Callable

from canopen.sdo.server import SdoServer

import canopen
from canopen import SdoAbortedError
from hilbench.canopen.eds import with_mapped_pdos
from hilbench.canopen.identifiers import SDO_ANSWER, SDO_REQUEST
from hilbench.canopen.object_store import (
    BLOCK_SIZE,
    CRC_ERROR,
    NO_DATA,
    READ_ONLY,
    SEQUENCE_NUMBER,
    TOO_LONG,
    TOO_SHORT,
    UNKNOWN_COMMAND,
    WRITE_ONLY,
    Cell,
    ObjectStore,
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


_REQUEST_BYTES = 8
#: Client command specifiers (the upper three bits of a request).
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT, _BLOCK_UPLOAD, _BLOCK_DOWNLOAD = range(7)
_EXPEDITED, _SIZE_INDICATED, _LAST_SEGMENT = 0x02, 0x01, 0x01
_SUBCOMMAND = 0x03  #: of a block transfer; 0 initiates one. In a block download only the lowest bit counts.


class _Outlet:
    """Outlet of canopen's server: a list instead of a bus."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self.send_message = send


class _Node(canopen.LocalNode):
    """canopen's local node with the object store in place of its own data."""

    def __init__(self, node_id: int, store: ObjectStore) -> None:
        super().__init__(node_id, with_mapped_pdos(store.od))
        self._store = store

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        cell = self._store.requested(index, subindex)
        if check_readable and not cell.variable.readable:
            raise SdoAbort(WRITE_ONLY)
        data = cell.encode()
        if not data:
            raise SdoAbort(NO_DATA)
        return data

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        cell = self._store.requested(index, subindex)
        if check_writable and not cell.variable.writable:
            raise SdoAbort(READ_ONLY)
        cell.write(cell.decode(bytes(data)))


def may_write(data: bytes) -> bool:
    """True if a request can change an object: it is no upload."""
    return not data or data[0] >> 5 not in (_UPLOAD, _UPLOAD_SEGMENT, _BLOCK_UPLOAD)


class DeviceSdoServer(SdoServer):
    """SDO server whose requests come in by `handle` and whose answers go out through `send(cob_id, data)`."""

    def __init__(self, node_id: int, store: ObjectStore, send: Callable[[int, bytes], None]) -> None:
        super().__init__(SDO_REQUEST + node_id, SDO_ANSWER + node_id, _Node(node_id, store))
        self.network = _Outlet(send)  # type: ignore[assignment]
        self._store = store
        self._index, self._subindex = 0, 0  # named by an abort before the first transfer
        #: The one transfer that is under way: the specifier of its segments, or the block transfer itself.
        self._transfer: int | BlockDownload | BlockUpload | None = None
        self._announced: int | None = None

    def handle(self, data: bytes) -> None:
        """Answer one request; data that are no SDO request (not 8 bytes) are ignored."""
        if len(data) != _REQUEST_BYTES:
            return
        try:
            self._dispatch(data)
        except SdoAbortedError as refusal:
            self.reset()
            self.abort(refusal.code)

    def reset(self) -> None:
        """Drop the transfer that is under way."""
        self._transfer = None

    def _dispatch(self, data: bytes) -> None:
        specifier = data[0] >> 5
        transfer = self._transfer
        if data[0] == _ABORT << 5:
            self.reset()
        elif isinstance(transfer, BlockDownload) and (transfer.receiving or self._ends_download(data)):
            self._continue_block_download(transfer, data)
        elif isinstance(transfer, BlockUpload) and specifier == _BLOCK_UPLOAD and data[0] & _SUBCOMMAND:
            self._continue_block_upload(transfer, data)
        elif specifier in (_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT):
            if transfer != specifier:
                raise SdoAbort(UNKNOWN_COMMAND)  # a segment of no transfer
            if specifier == _UPLOAD_SEGMENT:
                self.segmented_upload(data[0])
            else:
                self.segmented_download(data[0], data)
        else:
            self._initiate(specifier, data)

    def _initiate(self, specifier: int, data: bytes) -> None:
        # Aborts name the object of the request that they refuse.
        self._index, self._subindex = struct.unpack_from("<HB", data, 1)
        self.reset()
        if specifier == _UPLOAD:
            self.init_upload(data)
        elif specifier == _DOWNLOAD:
            self.init_download(data)
        elif specifier == _BLOCK_UPLOAD and not data[0] & _SUBCOMMAND:
            self.block_upload(data)
        elif specifier == _BLOCK_DOWNLOAD and not self._ends_download(data):
            self.block_download(data)
        else:
            raise SdoAbort(UNKNOWN_COMMAND)

    # -- expedited and segmented -------------------------------------------------------------------------

    def init_upload(self, request: bytes) -> None:
        """Answer with the value, or its size where segments follow."""
        super().init_upload(request)
        if len(self._node.get_data(self._index, self._subindex)) > 4:
            self._transfer = _UPLOAD_SEGMENT

    def segmented_upload(self, command: int) -> None:
        """The next segment."""
        super().segmented_upload(command)
        if not self._buffer:
            self.reset()

    def init_download(self, request: bytes) -> None:
        """Refuse an absent or read-only object and a wrong size at once, not after the last segment."""
        command = request[0]
        segmented = not command & _EXPEDITED
        sized = command & _SIZE_INDICATED
        self._announced = struct.unpack_from("<I", request, 4)[0] if segmented and sized else None
        self._check_download(self._announced)
        super().init_download(self._with_size(request) if not segmented and not sized else request)
        if segmented:
            self._transfer = _DOWNLOAD_SEGMENT

    def segmented_download(self, command: int, request: bytes) -> None:
        """Take a segment; the last one writes the object."""
        received = len(self._buffer or b"") + 7 - (command >> 1 & 0x7)
        if self._announced is not None and received > self._announced:
            raise SdoAbort(TOO_LONG)
        if command & _LAST_SEGMENT and self._announced is not None and received < self._announced:
            raise SdoAbort(TOO_SHORT)
        super().segmented_download(command, request)
        if command & _LAST_SEGMENT:
            self.reset()

    def _check_download(self, size: int | None) -> None:
        cell = self._cell()
        if not cell.variable.writable:
            raise SdoAbort(READ_ONLY)
        if size is not None:
            cell.check_length(size)

    def _cell(self) -> Cell:
        """The object that the transfer is about. Raises SdoAbort when there is none."""
        return self._store.requested(int(self._index or 0), int(self._subindex or 0))

    def _with_size(self, request: bytes) -> bytes:
        """An expedited request that leaves its size open holds as many bytes as the object."""
        width = self._cell().width
        if width is None or width > 4:
            return request
        return bytes((request[0] | _SIZE_INDICATED | (4 - width) << 2,)) + request[1:]

    # -- block -------------------------------------------------------------------------------------------

    def block_upload(self, data: bytes) -> None:
        """Begin a block upload, or a normal one when the data are no longer than the client's threshold."""
        content = self._node.get_data(self._index, self._subindex, check_readable=True)
        if data[5] and len(content) <= data[5]:
            self.init_upload(data)
            return
        transfer = BlockUpload(data, content)
        self.send_response(transfer.initiated())
        self._transfer = transfer

    def block_download(self, data: bytes) -> None:
        """Begin a block download."""
        self._check_download(struct.unpack_from("<I", data, 4)[0] if data[0] & 0x02 else None)
        transfer = BlockDownload(data)
        self.send_response(transfer.initiated())
        self._transfer = transfer

    @staticmethod
    def _ends_download(data: bytes) -> bool:
        return data[0] >> 5 == _BLOCK_DOWNLOAD and bool(data[0] & 0x01)

    def _continue_block_download(self, transfer: BlockDownload, data: bytes) -> None:
        if transfer.receiving:
            answer = transfer.segment(data)
            if answer is not None:
                self.send_response(answer)
            return
        self._node.set_data(self._index, self._subindex, transfer.end(data), check_writable=True)
        self.send_response(transfer.ended())
        self.reset()

    def _continue_block_upload(self, transfer: BlockUpload, data: bytes) -> None:
        for answer in transfer.handle(data):
            self.send_response(answer)
        if transfer.done:
            self.reset()
