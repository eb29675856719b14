"""The bus as a case sees it: frames out, frames in, and time that passes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

from hilbench.can.frame import Frame
from hilbench.can.link import Link

#: How far the mean of periods may be from the commanded one: below that it may be the listener.
_SLACK: Final = 0.15
#: Between two looks at whether to end.
_LONGEST_WAIT_S: Final = 0.1


class Wire:
    """A bus of this machine on which a device is examined, in real time.

    Raises BusError when the bus is lost. `end_if_requested` is called while frames are waited for; what it raises ends
    the wait.
    """

    def __init__(self, link: Link, end_if_requested: Callable[[], None] = lambda: None) -> None:
        self._link = link
        self._end_if_requested = end_if_requested
        self._waiting: deque[Frame] = deque()

    def now_s(self) -> float:
        """Time that passes (seconds), for differences."""
        return time.monotonic()

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame at once."""
        self._link.send([Frame(can_id, data)])

    def listen(self, duration_s: float, until: Callable[[Frame], bool] | None = None) -> list[Frame]:
        """Frames in this time; up to and with the first frame for which `until` is true. Sleeps between frames; with
        no time it is what waits already."""
        found: list[Frame] = []
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
                self._waiting.append(frame if frame.time_ns else frame._replace(time_ns=time.monotonic_ns()))


def steady(found: list[Frame], period_s: float) -> bool:
    """True if the mean period is `period_s`, within the tolerance."""
    return len(found) > 1 and abs(_mean_period_s(found) - period_s) <= _SLACK * period_s


def periods(found: list[Frame]) -> str:
    """The mean of the periods, for a person."""
    return f", {1000.0 * _mean_period_s(found):.1f} ms on average" if len(found) > 1 else ""


def _mean_period_s(found: list[Frame]) -> float:
    return (found[-1].time_ns - found[0].time_ns) * 1e-9 / (len(found) - 1)
