"""The SDO server of a device: canopen's, on the device's object store, with its answers corrected."""

from __future__ import annotations

import struct
from collections.abc import Callable

import canopen
from canopen import SdoAbortedError
from canopen.sdo.server import SdoServer

from hilbench.fieldbus.object_store import NO_DATA, READ_ONLY, WRITE_ONLY, ObjectStore, SdoAbort

_INVALID_COMMAND = 0x05040001
_INITIATING = (1, 2, 5, 6)  # client command specifiers whose request carries index and sub-index


class _Outlet:
    """What canopen's server sends through: a list instead of a bus."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self.send_message = send


class _Node(canopen.LocalNode):
    """canopen's local node with the object store in place of its own data."""

    def __init__(self, node_id: int, store: ObjectStore) -> None:
        super().__init__(node_id, store.od)
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


class DeviceSdoServer(SdoServer):
    """SDO server whose requests come in by `handle` and whose answers go out through `send(cob_id, data)`."""

    def __init__(self, node_id: int, store: ObjectStore, send: Callable[[int, bytes], None]) -> None:
        super().__init__(0x600 + node_id, 0x580 + node_id, _Node(node_id, store))
        self.network = _Outlet(send)  # type: ignore[assignment]
        self._store = store

    def handle(self, data: bytes) -> None:
        """Answer one request; data that are no SDO request (not 8 bytes) are ignored."""
        if len(data) != 8:
            return
        command = data[0] >> 5
        if command in _INITIATING:
            # Aborts name the object of the request that they refuse.
            self._index, self._subindex = struct.unpack_from("<HB", data, 1)
            self._buffer = None if command in (1, 2) else self._buffer
        elif command != 4 and self._index is None:
            self._index, self._subindex = 0, 0
        if command in (0, 3) and self._buffer is None:
            self.abort(_INVALID_COMMAND)  # a segment of no transfer
            return
        self.on_request(self.rx_cobid, data, 0.0)

    def init_download(self, request: bytes) -> None:
        """Refuse a read-only or absent object at once, not after its last segment."""
        index, sub = struct.unpack_from("<HB", request, 1)
        if not self._store.requested(index, sub).variable.writable:
            raise SdoAbortedError(READ_ONLY)
        super().init_download(request)
