"""Link to the embedded bus, by its packets, for the cyclic path."""

from __future__ import annotations

import socket
import struct
from collections import deque
from collections.abc import Sequence
from math import ceil

from hilbench.can import hub_client, protocol
from hilbench.can.confinement import ControllerState, bus_off, state_in_message
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, Frame
from hilbench.can.link import wait_readable, wait_writable
from hilbench.can.requests import Wanted
from hilbench.errors import BusError

#: A sender that floods waits for the wire; a wire that takes nothing for so long is lost.
_SEND_TIMEOUT_S = 5.0
_HEADER = protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0)


def check_frame(can_id: int, data: bytes) -> None:
    """Raise ValueError for a classical frame that cannot be on a wire."""
    if can_id & ERROR_FLAG:
        raise ValueError(f"0x{can_id:X}: an error frame, which the bus itself makes")
    if can_id & 0x1FFFF800 and not can_id & EXTENDED_FLAG:
        raise ValueError(f"identifier 0x{can_id:X}: not an 11-bit one, and without the flag of a 29-bit one")
    if len(data) > 8:
        raise ValueError(f"frame 0x{can_id:X}: found {len(data)} data bytes, expected up to 8")


def can_record(can_id: int, data: bytes) -> bytes:
    """`struct can_frame` of a classical frame. Raises ValueError for one that cannot be on a wire."""
    if not 0 <= can_id <= 0x7FF or len(data) > 8:
        check_frame(can_id, data)
    return protocol.CAN_RECORD.pack(can_id, len(data), 0, data)


def send_packet(connection: socket.socket, channel: str, packet: bytes) -> None:
    """Hand a packet to the hub; waits while the transmit queue is full. Raises BusError if the bus is lost."""
    while True:
        try:
            connection.send(packet, socket.MSG_DONTWAIT)
            return
        except BlockingIOError:
            if not wait_writable(connection.fileno(), _SEND_TIMEOUT_S):
                raise BusError(f"embedded bus {channel}: took no frame for {_SEND_TIMEOUT_S:g} s") from None
        except OSError:
            raise hub_client.hub_lost(channel) from None


def receive_packet(connection: socket.socket, channel: str, flags: int = socket.MSG_DONTWAIT) -> bytes | None:
    """The next packet that waits, or None. Raises BusError if the bus is lost."""
    try:
        packet = connection.recv(protocol.PACKET_BYTES, flags)
    except BlockingIOError:
        return None
    except OSError:
        raise hub_client.hub_lost(channel) from None
    if not packet:
        raise hub_client.hub_lost(channel)
    return packet


class EmbeddedLink:
    """Link to one channel of the embedded bus; `timing` and `bitrate` must be those of the bus if it already runs."""

    def __init__(self, channel: str, bitrate: int, timing: str) -> None:
        self.channel = channel
        self.dropped = 0
        self.controller = ControllerState.ERROR_ACTIVE
        membership = hub_client.join(channel, Wanted(bitrate=bitrate, timing=timing))
        self._station = membership.station
        self._connection = membership.connection
        # Where time is virtual a wait need not end to the microsecond: the kernel's own time-out, in its ticks, saves a
        # call. `select` has the resolution of a cycle.
        self._waits_in_ticks = timing == "virtual"
        self._tick_timeout_s = 0.0  # as set
        self._connection.setblocking(self._waits_in_ticks)

    def send(self, frames: Sequence[Frame]) -> None:
        records = [can_record(can_id, data) for can_id, data, _ in frames]
        for start in range(0, len(records), protocol.MAX_RECORDS):
            self.send_records(b"".join(records[start : start + protocol.MAX_RECORDS]))

    def send_records(self, records: bytes) -> None:
        """`protocol.CAN_RECORD`s of frames that can be on a wire, up to `protocol.MAX_RECORDS`."""
        send_packet(self._connection, self.channel, _HEADER + records)

    def packet(self, frame: Frame) -> bytes:
        return _HEADER + can_record(frame.can_id, frame.data)

    def receive(self, timeout_s: float) -> list[Frame]:
        return self.frames_from(self.receive_packet(timeout_s))

    def frames_from(self, *received: bytes | None) -> list[Frame]:
        """The frames of packets that were received (None: nothing was), and of those that wait behind them. Raises
        BusError."""
        frames: list[Frame] = []
        packets = deque(packet for packet in received if packet is not None)
        while packets:
            packet = packets.popleft()
            body = memoryview(packet)[protocol.HEADER.size :]
            for can_id, length, _, data, time_ns in protocol.STAMPED_CAN_RECORD.iter_unpack(body):
                if can_id & ERROR_FLAG:
                    self.controller = state_in_message(can_id, data) or self.controller
                else:
                    frames.append(Frame(can_id, data[:length], time_ns))
            _, self.dropped = protocol.HEADER.unpack_from(packet)
            if not packets and (following := receive_packet(self._connection, self.channel)) is not None:
                packets.append(following)
        if self.controller is ControllerState.BUS_OFF:
            raise bus_off(f"embedded bus {self.channel}")
        return frames

    def receive_packet(self, timeout_s: float) -> bytes | None:
        """Packet that waits, or comes within the time: `protocol.HEADER` and `protocol.STAMPED_CAN_RECORD`s; for
        `frames_from`, or a caller that decodes it. Raises BusError when the bus is lost."""
        if self._waits_in_ticks and timeout_s > 0.0:
            self._set_tick_timeout(timeout_s)
            return receive_packet(self._connection, self.channel, flags=0)
        packet = receive_packet(self._connection, self.channel)
        if packet is None and timeout_s > 0.0 and wait_readable(self._connection.fileno(), timeout_s):
            packet = receive_packet(self._connection, self.channel)
        return packet

    def _set_tick_timeout(self, timeout_s: float) -> None:
        if timeout_s != self._tick_timeout_s:
            self._tick_timeout_s = timeout_s
            seconds, microseconds = divmod(ceil(timeout_s * 1e6), 1_000_000)
            self._connection.setsockopt(
                socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", seconds, microseconds)
            )

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        hub_client.set_filters(self.channel, self._station, identifiers)

    def fileno(self) -> int:
        return self._connection.fileno()

    def close(self) -> None:
        self._connection.close()
