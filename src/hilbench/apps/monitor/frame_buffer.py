"""The frames of the last cycles, for who looks ahead from them."""

from __future__ import annotations

from collections import deque

from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.results.received import SYNCS


class RecentFrames:
    """Frames of about `hilbench.results.received.SYNCS` cycles."""

    def __init__(self) -> None:
        self._received: deque[list[Frame]] = deque()
        self._syncs = 0

    def take(self, frames: list[Frame]) -> None:
        """Add received frames."""
        self._received.append(frames)
        self._syncs += _syncs(frames)
        while self._syncs - (oldest := _syncs(self._received[0])) > SYNCS:
            self._received.popleft()
            self._syncs -= oldest

    def frames(self) -> list[Frame]:
        """All of them, in their order."""
        return [frame for received in self._received for frame in received]


def _syncs(frames: list[Frame]) -> int:
    return sum(frame.can_id == SYNC for frame in frames)
