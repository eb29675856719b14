"""The embedded bus as a python-can interface: ``can.Bus(interface="hilbench", channel="hilbench0")``."""

from __future__ import annotations

import time
from typing import Any

from hilbench.can import hub_client, protocol
from hilbench.can.adapter import identifier_with_flags, kernel_filters, to_message
from hilbench.can.embedded import can_record, receive_packet, send_packet
from hilbench.can.frame import Frame
from hilbench.can.link import wait_readable
from hilbench.can.python_can import can
from hilbench.can.requests import Wanted
from hilbench.errors import BusError

_CLASSICAL_HEADER = protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0)
_FD_HEADER = protocol.HEADER.pack(protocol.KIND_FD, 0)


class EmbeddedBus(can.BusABC):
    """One station on an emulated CAN bus that any program of the same user can join.

    `channel` names the bus. `bitrate` and `data_bitrate` (bit/s) and `timing` ("real": a frame takes its bit time;
    "virtual": bus time is counted without waiting) are decided by the first station (defaults 1 Mbit/s, 2 Mbit/s,
    real); a later one that asks for something else is refused. With `fd` CAN FD frames are sent and received.
    Options that other interfaces know (`single_handle`, ...) have no meaning here and are ignored.
    Filters work in the hub. While a frame waits, `fileno()` is readable.
    """

    def __init__(
        self,
        channel: Any = None,
        can_filters: can.typechecking.CanFilters | None = None,
        *,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        timing: str | None = None,
        fd: bool = False,
        receive_own_messages: bool = False,
        **kwargs: Any,
    ) -> None:
        self.channel = protocol.DEFAULT_CHANNEL if channel is None else str(channel)
        self.channel_info = f"hilbench embedded bus {self.channel}"
        #: Frames this station lost because it did not read fast enough.
        self.dropped = 0
        wanted = Wanted(bitrate, data_bitrate, timing)
        try:
            membership = hub_client.join(
                self.channel,
                wanted,
                filters=kernel_filters(can_filters),
                receive_own=receive_own_messages,
                fd=fd,
                single=True,
            )
        except BusError as error:
            raise can.CanInitializationError(str(error)) from error
        self._station = membership.station
        self._connection = membership.connection
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        super().__init__(channel, can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame for the wire; waits while the station's transmit queue is full (at most 5 s)."""
        try:
            send_packet(self._connection, self.channel, self._packet(msg))
        except (BusError, ValueError) as error:
            raise can.CanOperationError(str(error)) from error

    def _packet(self, msg: can.Message) -> bytes:
        can_id = identifier_with_flags(msg)
        if not msg.is_fd:
            return _CLASSICAL_HEADER + can_record(can_id, bytes(msg.dlc) if msg.is_remote_frame else bytes(msg.data))
        if self.protocol is not can.CanProtocol.CAN_FD:
            raise ValueError("a CAN FD frame, expected a bus opened with fd=True")
        flags = protocol.BIT_RATE_SWITCH if msg.bitrate_switch else 0
        padded = bytes(msg.data).ljust(can.util.dlc2len(can.util.len2dlc(msg.dlc)), b"\0")
        return _FD_HEADER + protocol.FD_RECORD.pack(can_id, len(padded), flags, padded)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        try:
            while (packet := receive_packet(self._connection, self.channel)) is None:
                remaining = 3600.0 if deadline is None else deadline - time.monotonic()
                if remaining <= 0 or not wait_readable(self._connection.fileno(), remaining):
                    if deadline is None:
                        continue
                    return None, True
        except BusError as error:
            raise can.CanOperationError(str(error)) from error
        kind, self.dropped = protocol.HEADER.unpack_from(packet)
        return self._message(kind, packet), True

    def _message(self, kind: int, packet: bytes) -> can.Message:
        record = protocol.STAMPED_FD_RECORD if kind == protocol.KIND_FD else protocol.STAMPED_CAN_RECORD
        can_id, length, flags, data, time_ns = record.unpack_from(packet, protocol.HEADER.size)
        message = to_message(Frame(can_id, data[:length], time_ns), self.channel, is_rx=not flags & protocol.OWN)
        if kind == protocol.KIND_FD:
            message.is_fd = True
            message.bitrate_switch = bool(flags & protocol.BIT_RATE_SWITCH)
        return message

    def _apply_filters(self, filters: can.typechecking.CanFilters | None) -> None:
        try:
            hub_client.set_filters(self.channel, self._station, kernel_filters(filters))
        except BusError as error:
            raise can.CanOperationError(str(error)) from error

    def fileno(self) -> int:
        return self._connection.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._connection.close()

    @staticmethod
    def _detect_available_configs() -> list[can.typechecking.AutoDetectedConfig]:
        """Channels that are open now."""
        return [
            can.typechecking.AutoDetectedConfig(interface="hilbench", channel=name)
            for name in hub_client.running_channels()
        ]
