"""When SYNC comes: period and phase out of arrivals that jitter, stay away for a while, or are read in a bunch."""

from __future__ import annotations

from collections import deque

#: Gains of the loop that follows SYNC: a third of the arrivals' jitter is left in the phase, a hundredth in the period.
_PHASE_GAIN = 1 / 8
_PERIOD_GAIN = 1 / 120
#: So many intervals in a row that differ by no more than this part of them are a period.
_ALIKE, _ALIKE_WITHIN = 3, 0.25
_SHORTEST_NS = 100_000
#: SYNCs in their time, one after the other, after which the period is known.
_SETTLED = 8


class SyncTime:
    """Follows SYNC as the clock of a servo drive does that locks to it; times in ns of one clock.

    A SYNC that comes nearer to its time than to the one before or after it moves phase and period a little. Any other
    one has come late, after lost ones, or by a new period: it is taken as it comes, and a period that it and those
    before it agree upon counts from then on.
    """

    def __init__(self, period_ns: int) -> None:
        """`period_ns`: what is expected until another one is measured."""
        self.period_ns = period_ns
        self.at_ns: int | None = None  #: of the last SYNC, None before the first
        self._heard_ns = 0
        self._intervals: deque[int] = deque(maxlen=_ALIKE)
        self._in_time = 0

    @property
    def settled(self) -> bool:
        """Whether SYNC keeps the period."""
        return self._in_time >= _SETTLED

    @property
    def next_ns(self) -> int:
        """When the next SYNC is due. Only after the first one."""
        assert self.at_ns is not None, "after the first SYNC"
        return self.at_ns + self.period_ns

    def heard(self, now_ns: int, behind: int = 0) -> None:
        """A SYNC was read, and `behind` more that came after it wait: it came by as many periods earlier."""
        came_ns = now_ns - behind * self.period_ns
        if self.at_ns is None:
            self.at_ns = self._heard_ns = came_ns
            return
        if behind == 0:
            self._intervals.append(came_ns - self._heard_ns)
        else:
            self._intervals.clear()
        self._heard_ns = came_ns
        early_ns = came_ns - self.next_ns
        if 2 * abs(early_ns) <= self.period_ns:
            self.at_ns = self.next_ns + round(_PHASE_GAIN * early_ns)
            self.period_ns += round(_PERIOD_GAIN * early_ns)
            self._in_time += 1
            return
        self.at_ns = came_ns
        self._in_time = 0
        self._take_new_period()

    def _take_new_period(self) -> None:
        measured = sorted(self._intervals)
        if len(measured) < _ALIKE:
            return
        mean_ns = sum(measured) // _ALIKE
        if mean_ns >= _SHORTEST_NS and measured[-1] - measured[0] <= _ALIKE_WITHIN * mean_ns:
            self.period_ns = mean_ns
