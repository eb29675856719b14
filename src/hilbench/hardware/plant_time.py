"""How far the simulated hardware has to go, and when: by SYNCs in lockstep, by the clock otherwise.

All counts are sample times of the drives' loops: the plant can't stop between two. What is left over is carried, or
the sample time made one that fits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hilbench.canopen.clock import SyncTime

#: How far the clock that paces SYNC may be from ours, for the drives to follow it: this part of the time, and what
#: jitter looks like (sample times, and part of the config's cycle).
_CLOCKS_DIFFER, _JITTER_SAMPLES, _JITTER_CYCLES = 1e-3, 2, 0.25
#: So long it must have fitted again before it is followed anew.
_FITS_NS = 1_000_000_000
#: A period is one of so many sample times if it is so near to it.
_NEAR = 0.03
#: A process that was away longer than this does not make up for it.
_LONGEST_GAP_NS = 1_000_000_000
#: Part of the cycle by which a period is said to be another one.
_ANOTHER = 0.05


class PlantTime(Protocol):
    """Sample times to go; the caller goes them at once."""

    @property
    def sample_s(self) -> float:
        """Present sample time, s."""

    def before_sync(self, behind: int) -> int:
        """A SYNC is here (and `behind` more wait): to its time."""

    def after_sync(self) -> int:
        """Set points have acted: ahead, so that the answer to the next SYNC is ready when it comes."""

    def without_sync(self, duration_s: float) -> int:
        """No SYNC is here, and `duration_s` of wall time has passed since this was last asked."""


class BySync:
    """Lockstep: a SYNC is one cycle, however long it takes, as the SYNC producer waits for the answers."""

    def __init__(self, cycle_s: float, sample_s: float) -> None:
        self._cycle = round(cycle_s / sample_s)
        self.sample_s = sample_s
        self._left_s = 0.0

    def before_sync(self, behind: int) -> int:
        return 0

    def after_sync(self) -> int:
        return self._cycle

    def without_sync(self, duration_s: float) -> int:
        self._left_s += duration_s
        samples = int(self._left_s / self.sample_s + 1e-6)
        self._left_s -= samples * self.sample_s
        return samples


class ByClock:
    """The plant keeps up with `now_ns`, whatever SYNC does: comes by another period than the config's, jitters, stops.

    As long as SYNC comes by whole sample times the plant is locked to it, as a real drive is: so many sample times
    for every period, however the arrivals jitter, and the difference of two good clocks is followed. When that does not
    fit the time, the plant is, to the nearest sample time, where it has to be at the time of each SYNC. It runs ahead
    by no more than the config's cycle, so that set points that come without SYNC act soon.

    any_period: the plant takes any sample time. It is locked to SYNC of every period then, by the sample time nearest
    to `sample_s` of which the period is a multiple.
    """

    def __init__(
        self,
        cycle_s: float,
        sample_s: float,
        now_ns: Callable[[], int],
        report: Callable[[str], None],
        *,
        any_period: bool = False,
    ) -> None:
        self._cycle_ns = round(cycle_s * 1e9)
        self._given_s = sample_s
        self._given_ns = self._sample_ns = round(sample_s * 1e9)
        self._any_period = any_period
        self._now_ns = now_ns
        self._report = report
        self._sync = SyncTime(self._cycle_ns)
        self._reported = False
        self._elapsed = 0  #: sample times that the plant has gone
        #: A time, and how many sample times are due then; None: the plant has not begun.
        self._anchor_ns: int | None = None
        self._anchor = 0
        self._per_period = 0  #: sample times while locked, else 0
        self._since_ns, self._periods = 0, 0  #: since it was locked or unlocked: when, and periods of SYNC
        self._shift_ns = 0  #: what the anchor was moved by to follow SYNC

    @property
    def sample_s(self) -> float:
        return self._given_s if self._sample_ns == self._given_ns else self._sample_ns * 1e-9

    def before_sync(self, behind: int) -> int:
        first = self._sync.at_ns is None
        periods = self._sync.received(self._now_ns(), behind)
        if first or self._sync.pop_new_period():
            self._lock()
        else:
            self._follow(periods)
        if not self._reported and self._sync.settled:
            self._report_period()
        return self._go_to(self._at_ns, nearest=True)

    def after_sync(self) -> int:
        return self._go_to(self._at_ns + min(self._period_ns, self._cycle_ns), nearest=True)

    def without_sync(self, duration_s: float) -> int:
        now_ns = self._now_ns()
        if self._sync.at_ns is not None and now_ns < self._at_ns + 3 * self._period_ns // 2:
            now_ns = min(now_ns, self._at_ns + self._period_ns)  # it may still come in its time
        return self._go_to(now_ns, nearest=False)

    @property
    def _at_ns(self) -> int:
        assert self._sync.at_ns is not None, "at or after a SYNC"
        return self._sync.at_ns

    @property
    def _period_ns(self) -> int:
        return self._per_period * self._sample_ns or self._sync.period_ns

    def _lock(self) -> None:
        """Follow the clock of SYNC from here on, if the period is one of whole sample times."""
        self._unlock()
        per_period = round(self._sync.period_ns / self._given_ns)
        if self._any_period:
            self._lock_any(max(1, per_period))
        elif per_period and abs(self._sync.period_ns - per_period * self._sample_ns) <= _NEAR * self._sync.period_ns:
            self._per_period = per_period
            due = self._due(self._at_ns)
            self._move_anchor(self._at_ns, (due + self._sample_ns // 2) // self._sample_ns)
        self._since_ns, self._periods = self._at_ns, 0

    def _lock_any(self, per_period: int) -> None:
        gap_ns = self._due(self._at_ns) - self._elapsed * self._sample_ns
        self._per_period = per_period
        self._fit_sample_time()
        self._anchor_ns, self._anchor = self._at_ns, self._elapsed + round(gap_ns / self._sample_ns)

    def _fit_sample_time(self) -> None:
        period_ns, whole_ns = self._sync.period_ns, self._per_period * self._given_ns
        whole = abs(period_ns - whole_ns) <= _CLOCKS_DIFFER * whole_ns
        self._sample_ns = self._given_ns if whole else round(period_ns / self._per_period)

    def _follow(self, periods: int) -> None:
        if self._any_period:
            self._follow_any(periods)
            return
        self._periods += periods
        followed_ns = self._at_ns - self._since_ns
        if not self._per_period:
            if followed_ns > _FITS_NS and self._fits(followed_ns):
                self._lock()
            return
        self._move_anchor(self._at_ns, self._anchor + periods * self._per_period)
        if self._is_off(followed_ns):
            self._unlock()
            self._since_ns, self._periods = self._at_ns, 0

    def _follow_any(self, periods: int) -> None:
        """Follow SYNC with the sample time that fits; miscounted SYNCs are corrected by the clock."""
        self._fit_sample_time()
        self._move_anchor(self._at_ns, self._anchor + periods * self._per_period)
        if self._is_off(self._at_ns - self._since_ns):
            samples = round(self._shift_ns / self._sample_ns)
            self._anchor += samples
            self._shift_ns -= samples * self._sample_ns
            self._since_ns = self._at_ns

    def _is_off(self, followed_ns: int) -> bool:
        """True if SYNC has shifted by more than jitter and the difference of two clocks explain."""
        jitter_ns = _JITTER_SAMPLES * self._sample_ns + _JITTER_CYCLES * self._cycle_ns
        return abs(self._shift_ns) > jitter_ns + _CLOCKS_DIFFER * followed_ns

    def _fits(self, duration_ns: int) -> bool:
        """True if the periods of a time were whole sample times, but for the clocks; if not, restart their count."""
        per_period = round(duration_ns / max(1, self._periods) / self._sample_ns)
        whole_ns = self._periods * per_period * self._sample_ns
        if abs(duration_ns - whole_ns) <= _CLOCKS_DIFFER * duration_ns:
            return True
        self._since_ns, self._periods = self._at_ns, 0
        return False

    def _unlock(self) -> None:
        """Go by our clock again, as if it had never been followed."""
        if self._anchor_ns is not None:
            self._anchor_ns -= self._shift_ns
        self._per_period = self._shift_ns = 0

    def _move_anchor(self, time_ns: int, samples: int) -> None:
        assert self._anchor_ns is not None, "locked after it has begun"
        self._shift_ns += time_ns - self._anchor_ns - (samples - self._anchor) * self._sample_ns
        self._anchor_ns, self._anchor = time_ns, samples

    def _due(self, time_ns: int) -> int:
        """Time that the plant has to have reached, in ns since its start."""
        if self._anchor_ns is None:
            self._anchor_ns = time_ns
        return self._anchor * self._sample_ns + time_ns - self._anchor_ns

    def _go_to(self, time_ns: int, nearest: bool) -> int:
        """Sample times to a time: the nearest to it, or the last before it."""
        gap_ns = self._due(time_ns) - self._elapsed * self._sample_ns
        if gap_ns > _LONGEST_GAP_NS:
            self._report(f"held up for {gap_ns * 1e-9:.1f} s: the simulated hardware stood still meanwhile")
            self._anchor_ns, self._anchor, self._shift_ns = time_ns, self._elapsed, 0
            return 0
        samples = max(0, (gap_ns + (self._sample_ns // 2 if nearest else 0)) // self._sample_ns)
        self._elapsed += samples
        return samples

    def _report_period(self) -> None:
        period_ns, cycle_ns = self._sync.period_ns, self._cycle_ns
        if abs(period_ns - cycle_ns) > _ANOTHER * cycle_ns:
            self._reported = True
            self._report(
                f"SYNC comes every {period_ns * 1e-6:.3g} ms, cycle_time_s is {cycle_ns * 1e-6:.3g} ms: "
                "the simulated hardware goes by time"
            )
