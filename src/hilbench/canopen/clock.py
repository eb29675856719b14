"""Time base of a device: the monotonic clock, or SYNC itself where no clock is real time; and that of SYNC as it
arrives: its period and phase from arrivals that jitter, stay away for a while, or are read in a bunch."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol


class Clock(Protocol):
    """Time of a device in ns, never set back."""

    def now_ns(self) -> int:
        """The present time."""

    def tick(self) -> None:
        """A SYNC has come."""

    def expect_sync(self) -> None:
        """Nodes were started: SYNC is about to begin."""

    def stalled_ns(self) -> int:
        """Wall time since SYNC stopped, 0 while it runs or where that does not matter."""


class MonotonicClock:
    """Wall time."""

    def __init__(self, stall_s: float = 0.1) -> None:
        self._stall_ns = int(stall_s * 1e9)
        self._last_sync_ns = -(1 << 62)

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def tick(self) -> None:
        self._last_sync_ns = time.monotonic_ns()

    def expect_sync(self) -> None:
        """Do nothing: wall time advances in any case."""

    def stalled_ns(self) -> int:
        return max(0, time.monotonic_ns() - self._last_sync_ns - self._stall_ns)


class SyncClock:
    """One cycle per SYNC, so that timers fall into the same cycle on every machine.

    Before nodes are started, and when none has come for `stall_s` of wall time, it advances by the wall clock: a dead
    master must be noticed. A slow master sends its heartbeat (COB-ID `kept_by`) meanwhile: while that comes, time is
    stopped.
    """

    def __init__(self, cycle_ns: int, stall_s: float = 5.0, kept_by: int | None = None) -> None:
        self.kept_by = kept_by
        self._cycle_ns = cycle_ns
        self._stall_ns = int(stall_s * 1e9)
        self._time_ns = time.monotonic_ns()
        self._last_sync_ns = self._time_ns - self._stall_ns

    def now_ns(self) -> int:
        return self._time_ns + self.stalled_ns()

    def tick(self) -> None:
        self._time_ns = self.now_ns() + self._cycle_ns
        self._last_sync_ns = time.monotonic_ns()

    @property
    def next_ns(self) -> int:
        """Time after the next SYNC, unless that stays away."""
        return self._time_ns + self._cycle_ns

    @property
    def stalls_at_ns(self) -> int:
        """Time of the monotonic clock until which SYNC counts as running though none comes."""
        return self._last_sync_ns + self._stall_ns

    def syncs_until(self, monotonic_ns: int, until_ns: int) -> int:
        """Number of SYNCs that do not lead beyond a time; 0 where none runs by the monotonic clock."""
        runs = monotonic_ns - self._last_sync_ns <= self._stall_ns
        return max(0, (until_ns - self._time_ns) // self._cycle_ns) if runs else 0

    def tick_at(self, monotonic_ns: int, syncs: int = 1) -> None:
        """`tick` for so many SYNCs; the caller has read the monotonic clock already and knows it is not stalled."""
        self._time_ns += syncs * self._cycle_ns
        self._last_sync_ns = monotonic_ns

    def expect_sync(self) -> None:
        """Stop until the first SYNC: timers due by the wall clock must not fall into its cycle by chance."""
        self._time_ns = self.now_ns()
        self._last_sync_ns = time.monotonic_ns()

    def keep(self) -> None:
        """Note that the master is alive. Once the wall clock is used only SYNC ends that."""
        if not self.stalled_ns():
            self._last_sync_ns = time.monotonic_ns()

    def stalled_ns(self) -> int:
        return max(0, time.monotonic_ns() - self._last_sync_ns - self._stall_ns)


#: Gains of the loop that follows SYNC: a third of the arrivals' jitter is left in the phase, a hundredth in the period.
_PHASE_GAIN = 1 / 8
_PERIOD_GAIN = 1 / 120
#: So many intervals in a row that differ by no more than this part of them are a period; another one than expected when
#: it differs by more than that, or by so many times as much as they do, and this part at least.
_ALIKE, _ALIKE_WITHIN = 5, 0.25
_SURELY, _LEAST = 2, 0.03
_SHORTEST_NS = 100_000
#: SYNCs in a row that were each one too many: the clock by which they are read was set back.
_SET_BACK = 3
#: SYNCs that came one period after the last one, after which the period is known.
_SETTLED = 8


class SyncTime:
    """Follows SYNC like the clock of a servo drive that locks to it; times in ns of one clock.

    An arrival belongs to the period that it is nearest to, so that lost SYNCs are counted, and jitter is not; one that
    is off by more than the expected period is no jitter, and taken as it comes. A period that several intervals in a
    row agree upon takes the place of the expected one.
    """

    def __init__(self, period_ns: int) -> None:
        """`period_ns`: expected period until another one is measured."""
        self.period_ns = period_ns
        self.at_ns: int | None = None  #: of the last SYNC, None before the first
        self._most_jitter_ns = period_ns
        self._received_ns = 0
        self._intervals: deque[int] = deque(maxlen=_ALIKE)
        self._regular = self._too_many = 0

    @property
    def settled(self) -> bool:
        """True if the period is known."""
        return self._regular >= _SETTLED

    @property
    def next_ns(self) -> int:
        """Time at which the next SYNC is due. Only after the first one."""
        assert self.at_ns is not None, "after the first SYNC"
        return self.at_ns + self.period_ns

    def received(self, now_ns: int, behind: int = 0) -> int:
        """Take a SYNC that was read while `behind` later ones wait: it came by as many periods earlier.

        Returns the number of periods since the one before: 1, more after lost ones, 0 for a surplus one.
        """
        came_ns = now_ns - behind * self.period_ns
        if self.at_ns is None:
            self.at_ns = self._received_ns = came_ns
            return 0
        if behind == 0:
            self._intervals.append(came_ns - self._received_ns)
        else:
            self._intervals.clear()
        self._received_ns = came_ns
        periods = max(0, 1 + round((came_ns - self.next_ns) / self.period_ns))
        late_ns = came_ns - self.at_ns - periods * self.period_ns
        self._too_many = self._too_many + 1 if periods == 0 else 0
        if self._too_many >= _SET_BACK:
            self.at_ns, self._too_many = came_ns, 0
            return 1
        if periods == 0:
            return 0
        jitters = abs(late_ns) <= self._most_jitter_ns
        self.at_ns += periods * self.period_ns + (round(_PHASE_GAIN * late_ns) if jitters else late_ns)
        if periods == 1:
            self.period_ns += round(_PERIOD_GAIN * late_ns)
            self._regular += 1
        return periods

    def pop_new_period(self) -> bool:
        """True if SYNC was found to have another period than expected, which is expected from here on."""
        measured = sorted(self._intervals)
        if len(measured) < _ALIKE:
            return False
        mean_ns = sum(measured) // _ALIKE
        spread_ns = measured[-1] - measured[0]
        alike = spread_ns <= _ALIKE_WITHIN * mean_ns
        surely_ns = max(_SURELY * spread_ns, _LEAST * self.period_ns)
        expected = abs(mean_ns - self.period_ns) <= min(surely_ns, _ALIKE_WITHIN * self.period_ns)
        if expected or not alike or mean_ns < _SHORTEST_NS:
            return False
        self.period_ns, self.at_ns, self._regular = mean_ns, self._received_ns, 0
        return True
