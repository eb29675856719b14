"""A run that has ended, played again: the frames of its trace as they come, in place of those of a bus."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from math import inf, isinf
from typing import Final

from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.errors import BusError
from hilbench.results.run_folder import RunFolder
from hilbench.results.trace import TraceReader

#: Cycles that come at once at most.
_MOST_CYCLES: Final = 200


class PlayedTrace:
    """Link that receives the trace of a run, cycle by cycle at `pace` times the time in which it was run; 0:
    paused, infinite: as fast as it is taken. A cycle takes the same time in lockstep, where its trace does not
    state it. Raises UnusableInputError on reading, for a trace that can't be read.
    """

    controller = ControllerState.ERROR_ACTIVE
    dropped = None

    def __init__(self, folder: RunFolder, cycle_s: float, now: Callable[[], float] = time.monotonic) -> None:
        self.channel = folder.name
        self.pace = 1.0
        self._cycle_s = cycle_s
        self._now = now
        self._asked_s = now()
        self._played_s = 0.0
        self._cycles = 0
        self._frames: Iterator[Frame] = iter(TraceReader(folder.trace))
        self._over = False

    def clock_s(self) -> float:
        """The time that has been played."""
        return self._played_s

    def receive(self, timeout_s: float) -> list[Frame]:
        """Frames since the last call; waits for `timeout_s` where there are none."""
        asked_s = self._now()
        elapsed_s, self._asked_s = asked_s - self._asked_s, asked_s
        last = self._cycles + _MOST_CYCLES - 1
        if isinf(self.pace) and not self._over:
            self._played_s = last * self._cycle_s
        else:
            self._played_s += elapsed_s * (1.0 if isinf(self.pace) else self.pace)
            if not self._over:
                self._played_s = min(self._played_s, last * self._cycle_s)
        frames = list(self._due())
        if not frames:
            time.sleep(timeout_s)
        return frames

    def _due(self) -> Iterator[Frame]:
        while not self._over and self._cycles * self._cycle_s <= self._played_s:
            frame = next(self._frames, None)
            self._over = frame is None
            if frame is not None:
                self._cycles += frame.can_id == SYNC
                yield frame

    def send(self, frames: Sequence[Frame]) -> None:
        """Nothing can be sent. Raises BusError."""
        raise BusError(f"{self.channel} is played again, expected a bench that runs")

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        """Receive all frames, whatever the filters."""

    def fileno(self) -> int:
        """Nothing to wait for. Raises BusError."""
        raise BusError(f"{self.channel} is played again, expected a bus")

    def close(self) -> None:
        """End the replay."""
        self._frames, self._over = iter(()), True


#: As fast as it goes.
FAST: Final = inf
