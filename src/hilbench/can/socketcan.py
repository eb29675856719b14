"""A link to a SocketCAN interface through a raw socket of our own: it counts lost frames, python-can's cannot.

See Linux, Documentation/networking/can.rst (CAN_RAW) and socket(7) (SO_RXQ_OVFL, SO_MEMINFO). With SO_RXQ_OVFL each
frame brings the number of frames that were lost before it; when no frame comes any more the socket is read, and so is
the interface, which may have lost frames before the socket got them.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Sequence

from hilbench.can.confinement import STATE_CLASSES, ControllerState, bus_off, state_in_message
from hilbench.can.embedded import can_record
from hilbench.can.frame import ERROR_FLAG, Frame
from hilbench.can.interfaces import InterfaceLosses
from hilbench.can.link import wait_readable
from hilbench.can.protocol import CAN_RECORD
from hilbench.errors import BusError

# <asm-generic/socket.h>; Python's socket module does not name them.
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_SO_MEMINFO = 55
_CAN_RAW_ERR_FILTER = 2  # <linux/can/raw.h>

RECEIVE_BUFFER_BYTES = 1 << 20  # 2731 frames (measured): 0.3 s of a full 1 Mbit/s bus
_TIMESPEC = struct.Struct("@ll")
_COUNT = struct.Struct("=I")
#: SO_MEMINFO gives nine counters (<linux/sock_diag.h>, SK_MEMINFO_VARS); the last is that of lost frames.
_MEMINFO = struct.Struct("=9I")
_FILTER = struct.Struct("=II")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)
#: A full transmit queue (ENOBUFS) cannot be polled for: look again after about two frames, give up after so long.
_RETRY_S = 0.0002
_SEND_TIMEOUT_S = 1.0


class SocketCanLink:
    """Link to the CAN network interface `channel`."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self._socket = _open(channel)
        self._socket_losses = 0
        self._interface = InterfaceLosses(channel)
        self._interface_losses = 0
        self.controller = ControllerState.ERROR_ACTIVE

    @property
    def dropped(self) -> int:
        """Frames lost by this socket, and by the interface since the socket was opened (`Link.dropped`)."""
        return self._socket_losses + self._interface_losses

    def send(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            self._send(can_record(frame.can_id, frame.data))

    def packet(self, frame: Frame) -> bytes:
        return can_record(frame.can_id, frame.data)

    def _send(self, record: bytes) -> None:
        deadline = time.monotonic() + _SEND_TIMEOUT_S
        while True:
            try:
                self._socket.send(record)
                return
            except OSError as error:
                if error.errno not in (errno.ENOBUFS, errno.EAGAIN) or time.monotonic() > deadline:
                    raise self._lost(error) from None
            time.sleep(_RETRY_S)

    def receive(self, timeout_s: float) -> list[Frame]:
        frames = self._waiting()
        if not frames and timeout_s > 0 and wait_readable(self._socket.fileno(), timeout_s):
            frames = self._waiting()
        if not frames:
            self._ask_for_losses()
        return frames

    def _ask_for_losses(self) -> None:
        """Losses that no later frame has brought yet."""
        self._interface_losses = self._interface.count()
        try:
            counters = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        except OSError:  # Linux before 4.12: the next frame shows it
            return
        self._socket_losses = _MEMINFO.unpack(counters)[-1]

    def _waiting(self) -> list[Frame]:
        frames: list[Frame] = []
        while True:
            try:
                record, ancillary, _, _ = self._socket.recvmsg(CAN_RECORD.size, _ANCILLARY_BYTES)
            except BlockingIOError:
                return frames
            except OSError as error:
                raise self._lost(error) from None
            can_id, length, _, data = CAN_RECORD.unpack(record)
            time_ns = self._read_ancillary(ancillary)
            if can_id & ERROR_FLAG:
                self._take_state(can_id, data)
            else:
                frames.append(Frame(can_id, data[:length], time_ns))

    def _take_state(self, can_id: int, data: bytes) -> None:
        """Take a controller state. Raises BusError when it has gone bus off; with restart-ms it recovers by itself."""
        before, self.controller = self.controller, state_in_message(can_id, data) or self.controller
        if self.controller is ControllerState.BUS_OFF and before is not ControllerState.BUS_OFF:
            raise bus_off(self.channel)

    def _read_ancillary(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        """Take over the drop counter; the time of reception, ns since the epoch."""
        time_ns = 0
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)
                time_ns = seconds * 1_000_000_000 + nanoseconds
            elif level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL:
                (self._socket_losses,) = _COUNT.unpack_from(data)
        return time_ns or time.time_ns()

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        pairs = [(0, 0)] if identifiers is None else identifiers
        packed = b"".join(_FILTER.pack(identifier, mask) for identifier, mask in pairs)
        try:
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)
        except OSError as error:
            raise self._lost(error) from None

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        if self._socket.fileno() >= 0:
            self._ask_for_losses()
            self._interface.close()
            self._socket.close()

    def _lost(self, error: OSError) -> BusError:
        if error.errno == errno.ENETDOWN:
            return BusError(f"{self.channel}: is down, expected it up (ip link set {self.channel} up)")
        if error.errno == errno.ENOBUFS:
            return BusError(
                f"{self.channel}: took no frame for {_SEND_TIMEOUT_S:g} s (is anybody on the bus to answer?)"
            )
        return BusError(f"{self.channel}: {error.strerror or error}")


def _open(channel: str) -> socket.socket:
    """A raw socket, bound. Raises BusError: no CAN in the kernel, no such interface, no CAN interface."""
    try:
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise BusError(
            f"socketcan:{channel}: this kernel has no CAN ({error.strerror}), expected SocketCAN (modprobe can_raw)"
        ) from None
    try:
        raw.setblocking(False)
        raw.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, STATE_CLASSES)
        _enlarge_receive_buffer(raw)
        raw.bind((channel,))
    except OSError as error:
        raw.close()
        if error.errno == errno.ENODEV:
            raise BusError(f"socketcan:{channel}: no such CAN interface (ip -brief link show)") from None
        raise BusError(f"socketcan:{channel}: {error.strerror or error}") from None
    return raw


def _enlarge_receive_buffer(raw: socket.socket) -> None:
    try:
        raw.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:  # needs CAP_NET_ADMIN; without it the kernel cuts the size to net.core.rmem_max
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
