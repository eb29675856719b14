"""Interface of the cyclic path to a bus: frames out in order, all waiting frames in, losses counted; waiting for its
file descriptor with the resolution that a cycle needs."""

from __future__ import annotations

import select
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame


class Link(Protocol):
    """A connection to one bus. Frames sent over it are not received back on it."""

    #: Name of the channel, as in a trace ("vcan0", "hilbench0").
    channel: str

    def send(self, frames: Sequence[Frame]) -> None:
        """Queue frames; they go onto the bus in this order. Raises BusError when the bus is lost."""

    def receive(self, timeout_s: float) -> list[Frame]:
        """All frames that are waiting; waits up to `timeout_s` for the first. Raises BusError when the bus is lost."""

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        """Receive only frames for which ``can_id & mask == id & mask`` for one (id, mask); None: every frame."""

    def fileno(self) -> int:
        """A file descriptor that becomes readable when a frame waits (for select/poll)."""

    @property
    def dropped(self) -> int | None:
        """Frames lost on this side because they were not read fast enough; None: unknown on this interface.

        Complete once the link is closed; while it is open, the latest losses may show with the next frame only.
        """

    @property
    def controller(self) -> ControllerState:
        """State of this side's controller, as far as the interface reports it. On bus off `receive` raises."""

    def close(self) -> None:
        """Leave the bus. Calling it twice is no error."""


@runtime_checkable
class PacketLink(Link, Protocol):
    """A link onto whose bus a frame can be put without the interpreter: by send(2) to its `fileno`."""

    def packet(self, frame: Frame) -> bytes:
        """Packet with the frame, as to be sent to the descriptor. Raises ValueError for an impossible frame."""


_SELECT_LIMIT = 1024  # FD_SETSIZE


def wait_readable(descriptor: int, timeout_s: float) -> bool:
    """True if `descriptor` is readable, or becomes so within `timeout_s`.

    select() waits in microseconds, poll() and epoll in whole milliseconds, rounded up: half a cycle.
    """
    if descriptor < _SELECT_LIMIT:
        return bool(select.select([descriptor], [], [], max(timeout_s, 0.0))[0])
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(timeout_s, 0.0) * 1e3))


def wait_writable(descriptor: int, timeout_s: float) -> bool:
    """True if `descriptor` takes data, or does so within `timeout_s`."""
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return bool(poll.poll(timeout_s * 1e3))
