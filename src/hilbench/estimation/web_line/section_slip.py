"""Slip of a web at the driven roller after a section of a line with stations, by the detector of every span.

A section is longer than a span, and its web may be slower: blocks are of equal web travel, and not of time. The
reference is the encoders' strain without corrections: a correction is web that the section really has, until it has
left.
"""

from __future__ import annotations

from collections import deque
from math import exp, inf
from typing import Final

import numpy as np

from hilbench.compiled import COUNT, VECTOR, Vector, entry_point, viewed
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line import anomalies, block_means

#: Travel of a block, as a share of the section's length: that of a block of 20 ms on a span of 1 m at 3 m/s.
_BLOCK_SHARE: Final = 0.06
_SLIP: Final = int(Problem.SLIP)
#: Blocks before a detected change at which it had not begun: those that the detector compares, and their means.
_BEFORE: Final = 12
#: Commands to the detector.
_BLOCK, _SUSPEND, _RESET = range(3)


#: States of the detector.
_NOTHING, _CHANGES, _SLIPS = range(3)


@entry_point(VECTOR, VECTOR, COUNT)
def _look(detector: Vector, of_block: Vector, what: int) -> int:
    s, block = viewed(detector, anomalies.ANOMALIES)[0], viewed(of_block, block_means.BLOCK)[0]
    if what == _BLOCK:
        anomalies.look(s, block)
    elif what == _SUSPEND:
        anomalies.suspend(s)
    else:
        anomalies.reset(s)
    if anomalies.found(s) == _SLIP:
        return _SLIPS
    return _CHANGES if anomalies.is_judging(s) else _NOTHING


class SectionSlip:
    """Slip detector of a section of this length and usual tension."""

    def __init__(self, usual_N: float, length_m: float) -> None:
        self._usual_N, self._length_m = usual_N, length_m
        self.reset(in_motion=False)

    def reset(self, *, in_motion: bool) -> None:
        """Reset for a released web; with `in_motion` its strain is unknown until it has left."""
        # Tensions by the model's E are passed in: the detector's own factor is 1.
        self._detector = anomalies.new_state(1.0, self._usual_N, self._length_m)
        self._block = np.zeros(1, block_means.BLOCK)
        self._corrected_N = 0.0
        self._begin()
        self._begins_s: deque[float] = deque(maxlen=_BEFORE)  # of the last blocks
        self._since_s = inf
        self._reported = _NOTHING
        self._report(_RESET if in_motion else _SUSPEND)

    @property
    def slips(self) -> bool:
        """True if the web slips."""
        return self._reported == _SLIPS

    @property
    def since_s(self) -> float:
        """Latest time at which the slip had not begun, if it `slips`."""
        return self._since_s

    def _report(self, what: int) -> None:
        before, self._reported = (
            self._reported,
            _look(self._detector.view(np.float64), self._block.view(np.float64), what),
        )
        if before == _NOTHING and self._reported == _CHANGES:
            self._since_s = self._begins_s[0]

    def _begin(self) -> None:
        """Start a new block."""
        self._count, self._sums_N = 0, np.zeros(2)
        self._travel_m = self._lasted_s = 0.0

    def suspend(self) -> None:
        """Forget the previous blocks: the measurement is unusable."""
        self._begin()
        self._begins_s.clear()
        self._report(_SUSPEND)

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
        if abs(self._travel_m) < _BLOCK_SHARE * self._length_m:
            return
        block = self._block
        block["force_N"], block["web_per_Pa"] = self._sums_N / self._count
        block["velocity_m_s"], block["duration_s"] = self._travel_m / self._lasted_s, self._lasted_s
        self._begins_s.append(time_s - self._lasted_s)
        self._report(_BLOCK)
        self._begin()
