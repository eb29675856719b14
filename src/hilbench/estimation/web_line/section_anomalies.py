"""Detector of a web break, or of slip at the driven roller after a section of a line with stations: that of every span.

For a slip blocks are of equal web travel, and not of time: a section is longer than a span, and its web may be slower.
The reference is then the encoders' strain without corrections: a correction is web that the section really has, until
it has left.
"""

from __future__ import annotations

from collections import deque
from math import exp, inf

import numpy as np

from hilbench.compiled import COUNT, VECTOR, Vector, entry_point, viewed
from hilbench.estimation.problems import PROBLEMS, Problem
from hilbench.estimation.web_line import anomalies, block_means

#: Commands to the detector.
_BLOCK, _SUSPEND, _RESET = range(3)


@entry_point(VECTOR, VECTOR, COUNT)
def _look(detector: Vector, of_block: Vector, what: int) -> tuple[int, bool]:
    s = viewed(detector, anomalies.ANOMALIES)[0]
    if what == _BLOCK:
        anomalies.look(s, viewed(of_block, block_means.BLOCK)[0])
    elif what == _SUSPEND:
        anomalies.suspend(s)
    else:
        anomalies.reset(s)
    return anomalies.found(s), anomalies.is_judging(s)


class SectionDetector:
    """Detector of a section of this length and usual tension; `block_m`: least travel of a block."""

    def __init__(self, usual_N: float, length_m: float, block_m: float) -> None:
        self._usual_N, self._length_m, self._block_m = usual_N, length_m, block_m
        self.reset(in_motion=False)

    def reset(self, *, in_motion: bool) -> None:
        """Reset for a released web; with `in_motion` its strain is unknown until it has left."""
        # Tensions by the model's E are passed in: the detector's own factor is 1.
        self._detector = anomalies.new_state(1.0, self._usual_N, self._length_m)
        self._block = np.zeros(1, block_means.BLOCK)
        self._corrected_N = 0.0
        self.since_s = inf  #: latest time at which what is judged, or found, had not begun
        self._begins_s: deque[float] = deque(maxlen=anomalies.BEFORE)  # of the blocks that a change is detected by
        self._tell(_RESET if in_motion else _SUSPEND)

    def _tell(self, what: int) -> None:
        if what != _BLOCK:
            self._begins_s.clear()
        found, judges = _look(self._detector.view(np.float64), self._block.view(np.float64), what)
        self.found: Problem | None = PROBLEMS[found]
        if found == 0 and not judges:
            self.since_s = inf
        elif self.since_s == inf:
            self.since_s = self._begins_s[0]
        self._count, self._sums_N = 0, np.zeros(2)
        self._travel_m = self._lasted_s = 0.0

    def suspend(self) -> None:
        """Forget the previous blocks: the measurement is unusable."""
        self._tell(_SUSPEND)

    def correct(self, change_N: float) -> None:
        """Account for a correction of the simulated line's tension (by the model's E)."""
        self._corrected_N += change_N

    def take(
        self, time_s: float, tension_N: float, followed_N: float, travel_m: float, duration_s: float, *, steady: bool
    ) -> None:
        """Take means since the last call: tension by the torques and of the simulated line by the model's E; web travel
        meanwhile. Nothing is judged across what is not `steady`."""
        self._corrected_N *= exp(-abs(travel_m) / self._length_m)
        if not steady:
            self.suspend()
            return
        self._count += 1
        self._sums_N += (tension_N, followed_N - self._corrected_N)
        self._travel_m += travel_m
        self._lasted_s += duration_s
        if abs(self._travel_m) < self._block_m:
            return
        block = self._block
        block["force_N"], block["web_per_Pa"] = self._sums_N / self._count
        block["velocity_m_s"], block["duration_s"] = self._travel_m / self._lasted_s, self._lasted_s
        self._begins_s.append(time_s - self._lasted_s)
        self._tell(_BLOCK)
