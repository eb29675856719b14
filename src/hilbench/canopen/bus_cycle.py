"""Length of the bus cycle, measured by the clock of a twin that is not paced by its bench.

The config gives the SYNC period; the SYNC producer may use another config, or be another master. A period that
SYNC keeps for long enough is the cycle from then on. Until then, and as long as SYNC flutters, cycles of the length
in use are counted: as many as there were in the elapsed time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from hilbench.canopen.clock import SyncTime

#: EMCY error code: SYNC comes by another cycle than the config's (CiA 301: FFxxh, device specific).
OTHER_CYCLE: Final = 0xFF19
#: Relative difference of another cycle from the one in use; difference from which it counts despite any jitter; and
#: tolerance within which a period is unchanged. No clock is as wrong as the first.
_ANOTHER, _PARTED, _SAME = 5e-3, 2e-2, 1e-2
#: SYNC must have had the new period for this time, and this often; twice as long each time when the last change was
#: recent, up to the longest.
_LASTS_NS, _PERIODS, _LONGEST_NS = 250_000_000, 32, 64_000_000_000
_SELDOM_NS = 60_000_000_000
#: Shortest and longest cycle, as of a config.
_SHORTEST_NS, _MOST_NS = 500_000, 100_000_000
#: A period that is so near (relative) to one which 60C2h can express is that one: a power of ten times a number up to
#: 255, rather one up to 25.
_EXPRESSED: Final = ((25, 5e-3), (255, 2e-3))


class BusCycle:
    """Follows SYNC by `now_ns`; `cycle_ns`: as the config has it."""

    def __init__(self, cycle_ns: int, now_ns: Callable[[], int]) -> None:
        self._cycle_ns = cycle_ns
        self._now_ns = now_ns
        self._sync = SyncTime(cycle_ns)
        self._lasts_ns = _LASTS_NS
        self._changed_ns: int | None = None
        self._due_ns = 0  # since SYNC has parted from the cycle, less the cycles that were counted
        self._hold(0)

    def _hold(self, period_ns: int) -> None:
        """SYNC has this period from now on; 0: that of the cycle."""
        self._period_ns, self._since_ns, self._periods = period_ns, self._sync.at_ns or 0, 0

    @property
    def in_step(self) -> bool:
        """True if the SYNC period is the cycle in use, as far as jitter lets that be seen at once."""
        return abs(self._period_ns - self._cycle_ns) <= _PARTED * self._cycle_ns if self._period_ns else True

    def received(self, behind: int) -> int:
        """Take a SYNC that was read while `behind` more wait; returns cycles since the one before: more than 1 after
        lost ones, 0 for a surplus one. For the first it is 1."""
        first = self._sync.at_ns is None
        periods = self._sync.received(self._now_ns(), behind)
        passed_ns = periods * self._sync.period_ns
        jumped = self._sync.pop_new_period()
        period_ns = self._sync.period_ns
        if abs(period_ns - self._cycle_ns) <= _ANOTHER * self._cycle_ns:
            self._hold(0)
            self._due_ns = 0
            return 1 if first else periods
        if jumped or abs(period_ns - self._period_ns) > _SAME * self._period_ns:
            self._hold(period_ns)
        else:
            self._periods += periods
        self._due_ns += passed_ns
        cycles = round(self._due_ns / self._cycle_ns)
        self._due_ns -= cycles * self._cycle_ns
        return cycles

    def pop_other(self) -> int | None:
        """New cycle (ns) to use from here on, if it differs from that in use, else None; to be called after each
        SYNC."""
        lasted_ns = (self._sync.at_ns or 0) - self._since_ns
        if not self._period_ns or self._periods < _PERIODS or lasted_ns < self._lasts_ns:
            return None
        cycle_ns = _as_expressed(lasted_ns // self._periods)
        is_another = abs(cycle_ns - self._cycle_ns) > _ANOTHER * self._cycle_ns
        if not (is_another and _SHORTEST_NS <= cycle_ns <= _MOST_NS):
            return None
        now_ns = self._now_ns()
        again = self._changed_ns is not None and now_ns - self._changed_ns < _SELDOM_NS
        self._lasts_ns = min(2 * self._lasts_ns, _LONGEST_NS) if again else _LASTS_NS
        self._changed_ns = now_ns
        self._cycle_ns = cycle_ns
        self._hold(0)
        self._due_ns = 0
        return cycle_ns


def _as_expressed(period_ns: int) -> int:
    """Nearest period that 60C2h of drives can express, if close enough: measured ones have clock errors."""
    for largest, near in _EXPRESSED:
        unit_ns = 1
        while period_ns / unit_ns > largest:
            unit_ns *= 10
        nominal_ns = round(period_ns / unit_ns) * unit_ns
        if abs(nominal_ns - period_ns) <= near * period_ns:
            return nominal_ns
    return period_ns
