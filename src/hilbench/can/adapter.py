"""A link over any python-can bus, and the conversion between its messages and our frames."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.can.confinement import ControllerState, bus_off, state_in_message
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame, accepts
from hilbench.can.python_can import can
from hilbench.errors import BusError, one_line


def identifier_with_flags(message: can.Message) -> int:
    """The kernel's identifier word of a message."""
    can_id = int(message.arbitration_id)
    if message.is_extended_id:
        can_id |= EXTENDED_FLAG
    if message.is_remote_frame:
        can_id |= REMOTE_FLAG
    if message.is_error_frame:
        can_id |= ERROR_FLAG
    return can_id


def to_frame(message: can.Message) -> Frame:
    """The frame of a classical message; its timestamp as `time_ns`."""
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return Frame(identifier_with_flags(message), data, round(message.timestamp * 1e9))


def to_message(frame: Frame, channel: str, is_rx: bool = True) -> can.Message:
    """The message of a frame that was received on `channel`."""
    can_id = frame.can_id
    remote = bool(can_id & REMOTE_FLAG)
    extended = bool(can_id & EXTENDED_FLAG)
    return can.Message(
        timestamp=frame.time_ns * 1e-9,
        arbitration_id=can_id & (0x1FFFFFFF if extended else 0x7FF),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=bool(can_id & ERROR_FLAG),
        channel=channel,
        dlc=len(frame.data),
        data=None if remote else frame.data,
        is_rx=is_rx,
    )


def kernel_filters(filters: can.typechecking.CanFilters | None) -> list[tuple[int, int]] | None:
    """python-can's filters as (identifier, mask) pairs with flag bits; as there, an empty list lets all pass."""
    if not filters:
        return None
    pairs = []
    for entry in filters:
        identifier, mask = int(entry["can_id"]), int(entry["can_mask"])
        if "extended" in entry:
            mask |= EXTENDED_FLAG
            identifier |= EXTENDED_FLAG if entry["extended"] else 0
        pairs.append((identifier, mask))
    return pairs


class PythonCanLink:
    """Link over `bus`, which it owns. python-can does not report losses of an interface: `dropped` is None."""

    def __init__(self, bus: can.BusABC, channel: str) -> None:
        self.channel = channel
        self.dropped: int | None = None
        self.controller = ControllerState.ERROR_ACTIVE
        self._bus = bus
        self._filters: Sequence[tuple[int, int]] | None = None

    def send(self, frames: Sequence[Frame]) -> None:
        try:
            for frame in frames:
                self._bus.send(to_message(frame, self.channel))
        except (can.CanError, OSError) as error:
            raise self._lost(error) from error

    def receive(self, timeout_s: float) -> list[Frame]:
        frames: list[Frame] = []
        try:
            message = self._bus.recv(max(timeout_s, 0.0))
            while message is not None:
                frame = to_frame(message)
                if frame.can_id & ERROR_FLAG:
                    self._take_state(frame)
                elif accepts(self._filters, frame.can_id):
                    frames.append(frame)
                message = self._bus.recv(0.0)
        except (can.CanError, OSError) as error:
            raise self._lost(error) from error
        return frames

    def _take_state(self, frame: Frame) -> None:
        before, self.controller = self.controller, state_in_message(frame.can_id, frame.data) or self.controller
        if self.controller is ControllerState.BUS_OFF and before is not ControllerState.BUS_OFF:
            raise bus_off(self.channel)

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        # Not with python-can's filters: where they work in software, recv(0) stops at the first frame they reject.
        self._filters = identifiers

    def fileno(self) -> int:
        try:
            return self._bus.fileno()
        except NotImplementedError:
            raise BusError(f"{self.channel}: this python-can interface has no file descriptor to wait for") from None

    def close(self) -> None:
        self._bus.shutdown()

    def _lost(self, error: Exception) -> BusError:
        return BusError(f"{self.channel}: {one_line(error)}")
