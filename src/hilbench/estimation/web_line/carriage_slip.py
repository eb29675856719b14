"""Slip of a web at a roller of a section with a carriage: more web is lost than strain can explain.

Inflow at the section's first roller, less outflow at its last and the room made by the carriage (by its sensor), is web
stretched in it, or slip. Web entering with another strain, or another E, loses a share that is no more than the usual
strain; a slip below that is not detected.
"""

from __future__ import annotations

from collections import deque
from math import inf
from typing import Final

#: Share of lost web, over the usual strain, from which on it slips, and below which it no longer does.
_SLIPS, _ENDS = 2.0, 1.0
#: Uncertainty of the room that a carriage makes, for each strand, m.
_ROOM_M: Final = 3e-4
#: Travel between records of the loss, as a share of the section's length.
_KEPT_EVERY: Final = 0.05


class CarriageSlip:
    """Slip detector of a section of this length and usual strain, with so many strands of web at its carriage."""

    def __init__(self, length_m: float, strands: int, strain: float) -> None:
        self._length_m, self._strain, self._unsure_m = length_m, strain, _ROOM_M * strands
        self.reset()

    def reset(self) -> None:
        """Forget all records."""
        #: Time, travel and loss of each record.
        self._kept: deque[tuple[float, float, float]] = deque()
        self._travel_m = self._lost_m = 0.0
        self.since_s = inf  #: latest time without slip; inf if nothing slips
        self._judged_m = 0.0  # travel at detection

    def take(self, time_s: float, before_m: float, behind_m: float, room_m: float, *, allowed: bool) -> None:
        """Take web travel since the last call: in by the roller before the section, out by the one after it, and the
        web length added by its carriage. A loss is `allowed` to be the strain of a web that changes."""
        self._travel_m += abs(behind_m)
        self._lost_m += before_m - behind_m - room_m
        if allowed:
            self._kept = deque((time_s, travel_m, self._lost_m) for time_s, travel_m, _ in self._kept)
        while len(self._kept) > 1 and self._kept[1][1] <= self._travel_m - self._length_m:
            self._kept.popleft()
        if not self._kept or self._travel_m - self._kept[-1][1] >= _KEPT_EVERY * self._length_m:
            self._judge()
            self._kept.append((time_s, self._travel_m, self._lost_m))

    def _judge(self) -> None:
        if self.since_s == inf:
            if any(self._is_lost(each, _SLIPS, self._unsure_m) for each in self._kept):
                self.since_s, self._judged_m = self._kept[0][0], self._travel_m
        elif self._travel_m - self._judged_m > self._length_m and not self._is_lost(self._kept[0], _ENDS, 0.0):
            self.since_s = inf

    def _is_lost(self, since: tuple[float, float, float], strains: float, unsure_m: float) -> bool:
        _, travel_m, lost_m = since
        return abs(self._lost_m - lost_m) > strains * self._strain * (self._travel_m - travel_m) + unsure_m
