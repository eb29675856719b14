"""The bus as a case sees it: frames out, frames in, and time that passes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from hilbench.can.frame import Frame
from hilbench.can.link import Link

#: How far the mean of periods may be from the commanded one: below that it may be the listener.
_SLACK: Final = 0.15
#: Between two looks at whether to end.
_LONGEST_WAIT_S: Final = 0.1


@dataclass(frozen=True)
class ReceivedFrame:
    """A frame from the bus; `at_s` (seconds) is for differences only. `can_id` has the flag bits of `Frame`."""

    at_s: float
    can_id: int
    data: bytes


class Wire(Protocol):
    """A bus on which a device is examined."""

    def now_s(self) -> float:
        """Time that passes (seconds), for differences."""

    def send(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus."""

    def listen(self, duration_s: float, until: Callable[[ReceivedFrame], bool] | None = None) -> list[ReceivedFrame]:
        """Frames in this time; up to and with the first frame for which `until` is true."""


class LinkWire:
    """A bus of this machine, in real time.

    Raises BusError when the bus is lost. `end_if_requested` is called while frames are waited for; what it raises ends
    the wait.
    """

    def __init__(self, link: Link, end_if_requested: Callable[[], None] = lambda: None) -> None:
        self._link = link
        self._end_if_requested = end_if_requested
        self._waiting: deque[ReceivedFrame] = deque()

    def now_s(self) -> float:
        """The monotonic clock."""
        return time.monotonic()

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame at once."""
        self._link.send([Frame(can_id, data)])

    def listen(self, duration_s: float, until: Callable[[ReceivedFrame], bool] | None = None) -> list[ReceivedFrame]:
        """Sleeps between frames. With no time it is what waits already."""
        found: list[ReceivedFrame] = []
        deadline_s = time.monotonic() + duration_s
        looked = False
        while True:
            while self._waiting:
                found.append(self._waiting.popleft())
                if until is not None and until(found[-1]):
                    return found
            left_s = max(0.0, deadline_s - time.monotonic())
            if looked and left_s == 0.0:
                return found
            self._end_if_requested()
            looked = True
            for frame in self._link.receive(min(left_s, _LONGEST_WAIT_S)):
                at_s = frame.time_ns * 1e-9 if frame.time_ns else time.monotonic()
                self._waiting.append(ReceivedFrame(at_s, frame.can_id, frame.data))


def steady(found: list[ReceivedFrame], period_s: float) -> bool:
    """True if the mean period is `period_s`, within the tolerance."""
    if len(found) < 2:
        return False
    mean_s = (found[-1].at_s - found[0].at_s) / (len(found) - 1)
    return abs(mean_s - period_s) <= _SLACK * period_s


def periods(found: list[ReceivedFrame]) -> str:
    """The mean of the periods, for a person."""
    if len(found) < 2:
        return ""
    return f", {1000.0 * (found[-1].at_s - found[0].at_s) / (len(found) - 1):.1f} ms on average"
