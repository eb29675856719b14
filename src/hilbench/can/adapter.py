"""A link over any python-can bus."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.can.arbitration import accepts
from hilbench.can.confinement import ControllerState, bus_off, state_in_message
from hilbench.can.frame import ERROR_FLAG, Frame
from hilbench.can.messages import to_frame, to_message
from hilbench.can.python_can import can
from hilbench.errors import BusError, one_line


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
