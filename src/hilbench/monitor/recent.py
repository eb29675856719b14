"""The frames of the last cycles, for who looks ahead from them."""

from __future__ import annotations

from collections import deque

from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.results.heard import SYNCS


class RecentFrames:
    """Those of about `hilbench.results.heard.SYNCS` cycles."""

    def __init__(self) -> None:
        self._heard: deque[list[Frame]] = deque()
        self._syncs = 0

    def take(self, frames: list[Frame]) -> None:
        """Add what was heard."""
        self._heard.append(frames)
        self._syncs += _syncs(frames)
        while self._syncs - (oldest := _syncs(self._heard[0])) > SYNCS:
            self._heard.popleft()
            self._syncs -= oldest

    def frames(self) -> list[Frame]:
        """All of them, in their order."""
        return [frame for heard in self._heard for frame in heard]


def _syncs(frames: list[Frame]) -> int:
    return sum(frame.can_id == SYNC for frame in frames)
