"""Time base of a device: the monotonic clock, or SYNC itself where no clock is real time."""

from __future__ import annotations

import time
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
