"""How far the simulated hardware has to go, and when: by SYNCs in lockstep, by the clock otherwise.

All counts are sample times of the drives' loops: the plant can't stop between two. What is left over is carried.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hilbench.fieldbus.sync_time import SyncTime

#: A real drive's clock follows the one that paces SYNC as far as two good clocks may differ; beyond that the drive's
#: own time counts.
_CLOCKS_DIFFER = 1e-3
#: A process that was away longer than this does not make up for it.
_LONGEST_GAP_NS = 1_000_000_000
#: Part of the cycle by which a period is said to be another one.
_ANOTHER = 0.05


class PlantTime(Protocol):
    """Sample times to go; the caller goes them at once."""

    def before_sync(self, behind: int) -> int:
        """A SYNC is here (and `behind` more wait): to its time."""

    def after_sync(self) -> int:
        """Set points have acted: ahead, so that the answer to the next SYNC is ready when it comes."""

    def without_sync(self, duration_s: float) -> int:
        """No SYNC is here, and `duration_s` of wall time has passed since this was last asked."""


class BySync:
    """A SYNC is one cycle, however long it takes: whoever sends it waits for the answers."""

    def __init__(self, cycle_s: float, sample_s: float) -> None:
        self._cycle = round(cycle_s / sample_s)
        self._sample_s = sample_s
        self._left_s = 0.0

    def before_sync(self, behind: int) -> int:
        return 0

    def after_sync(self) -> int:
        return self._cycle

    def without_sync(self, duration_s: float) -> int:
        self._left_s += duration_s
        samples = int(self._left_s / self._sample_s + 1e-6)
        self._left_s -= samples * self._sample_s
        return samples


class ByClock:
    """The plant keeps up with `now_ns`, whatever SYNC does: comes by another period than the config's, jitters, stops.

    At a SYNC the plant is where it was at the time of that SYNC, as `SyncTime` has it, to the nearest sample time; an
    arrival that jitters moves nothing. It runs ahead by no more than the config's cycle, so that set points that come
    without SYNC act soon.
    """

    def __init__(self, cycle_s: float, sample_s: float, now_ns: Callable[[], int], say: Callable[[str], None]) -> None:
        self._cycle_ns = round(cycle_s * 1e9)
        self._sample_ns = round(sample_s * 1e9)
        self._now_ns = now_ns
        self._say = say
        self._sync = SyncTime(self._cycle_ns)
        self._told = False
        self._plant_ns: int | None = None  #: the time that the plant has come to; None: it has not begun

    def before_sync(self, behind: int) -> int:
        self._sync.heard(self._now_ns(), behind)
        if not self._told and self._sync.settled:
            self._tell_period()
        assert self._sync.at_ns is not None, "just heard"
        return self._go_to(self._sync.at_ns)

    def after_sync(self) -> int:
        assert self._sync.at_ns is not None, "after a SYNC"
        assert self._plant_ns is not None, "as far as the SYNC"
        most_ns = int(_CLOCKS_DIFFER * self._sync.period_ns)
        self._plant_ns += max(-most_ns, min(most_ns, self._sync.at_ns - self._plant_ns))
        return self._go_to(self._sync.at_ns + min(self._sync.period_ns, self._cycle_ns))

    def without_sync(self, duration_s: float) -> int:
        now_ns = self._now_ns()
        if self._sync.at_ns is not None and now_ns < self._sync.next_ns + self._sync.period_ns // 2:
            now_ns = min(now_ns, self._sync.next_ns)  # it may still come in its time
        return self._go_to(now_ns - self._sample_ns // 2)

    def _go_to(self, time_ns: int) -> int:
        """Sample times to the one nearest to `time_ns`."""
        if self._plant_ns is None:
            self._plant_ns = time_ns
        gap_ns = time_ns - self._plant_ns
        if gap_ns > _LONGEST_GAP_NS:
            self._say(f"held up for {gap_ns * 1e-9:.1f} s: the simulated hardware stood still meanwhile")
            self._plant_ns = time_ns
            return 0
        samples = max(0, (gap_ns + self._sample_ns // 2) // self._sample_ns)
        self._plant_ns += samples * self._sample_ns
        return samples

    def _tell_period(self) -> None:
        period_ns, cycle_ns = self._sync.period_ns, self._cycle_ns
        if abs(period_ns - cycle_ns) > _ANOTHER * cycle_ns:
            self._told = True
            self._say(
                f"SYNC comes every {period_ns * 1e-6:.3g} ms, cycle_time_s is {cycle_ns * 1e-6:.3g} ms: "
                "the simulated hardware goes by time"
            )
