"""Slip of a web at the driven roller behind a section of a line with stations, by the detector of every span.

A section is longer than a span, and its web may be slower: what the detector looks at are blocks of so much web that
has gone through, and not of time. The strain that it compares with is that which the encoders show with nothing
corrected: what was corrected is web that the section has in truth, until it has left.
"""

from __future__ import annotations

from collections import deque
from math import exp, inf
from typing import Final

import numpy as np

from hilbench.compiled import COUNT, VECTOR, entry_point
from hilbench.estimation.bank import Array
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line import anomalies, block_means

#: Way of a block, as a share of the section's length: that of a block of 20 ms on a span of 1 m at 3 m/s.
_BLOCK_SHARE: Final = 0.06
_SLIP: Final = int(Problem.SLIP)
#: So many blocks before a change that the detector sees it had not begun: those that it compares, and their means.
_BEFORE: Final = 12
#: What the detector is told.
_BLOCK, _SUSPEND, _RESET = range(3)


#: What it says.
_NOTHING, _CHANGES, _SLIPS = range(3)


@entry_point(VECTOR, VECTOR, COUNT)
def _look(s: Array, block: Array, what: int) -> int:
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
    """Of a section of this length whose web usually has this tension."""

    def __init__(self, usual_N: float, length_m: float) -> None:
        self._usual_N, self._length_m = usual_N, length_m
        self.reset(under_way=False)

    def reset(self, *, under_way: bool) -> None:
        """The web is let go; of one that is under way nobody knows the strain until it has left."""
        # Promised are tensions, by the model's E: what is left for the detector to multiply with is 1.
        self._detector = anomalies.new_state(1.0, self._usual_N, self._length_m)
        self._block = np.zeros(block_means.MOTION_N + 1)
        self._corrected_N = 0.0
        self._begin()
        self._begins_s: deque[float] = deque(maxlen=_BEFORE)  # of the last blocks
        self._since_s = inf
        self._reported = _NOTHING
        self._report(_RESET if under_way else _SUSPEND)

    @property
    def slips(self) -> bool:
        """Whether the web slips."""
        return self._reported == _SLIPS

    @property
    def since_s(self) -> float:
        """When it had not begun yet, at the latest, where it `slips`."""
        return self._since_s

    def _report(self, what: int) -> None:
        before, self._reported = self._reported, _look(self._detector, self._block, what)
        if before == _NOTHING and self._reported == _CHANGES:
            self._since_s = self._begins_s[0]

    def _begin(self) -> None:
        """A new block."""
        self._count, self._sums_N = 0, np.zeros(2)
        self._travel_m = self._lasted_s = 0.0

    def suspend(self) -> None:
        """The measurement can't be used: what was before says nothing any more."""
        self._begin()
        self._begins_s.clear()
        self._report(_SUSPEND)

    def correct(self, change_N: float) -> None:
        """The tension that the followed line has by the model's E was corrected by so much."""
        self._corrected_N += change_N

    def take(
        self, time_s: float, tension_N: float, followed_N: float, travel_m: float, duration_s: float, *, steady: bool
    ) -> None:
        """Means since the last call: the tension that the torques show, and that of the followed line by the model's E;
        the way of the web meanwhile. Nothing is judged across what is not `steady`."""
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
        block[block_means.FORCE_N], block[block_means.WEB_PER_PA] = self._sums_N / self._count
        block[block_means.VELOCITY_M_S], block[block_means.DURATION_S] = self._travel_m / self._lasted_s, self._lasted_s
        self._begins_s.append(time_s - self._lasted_s)
        self._report(_BLOCK)
        self._begin()
