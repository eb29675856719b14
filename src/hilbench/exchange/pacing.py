"""Pacing of SYNC by the wall clock: absolute deadlines, missed cycles counted, jitter kept.

Functions on a small state, so that each can be tested without a bus. `lockstep` needs none of it: there the next
SYNC goes out as soon as every participant has answered. Where participants run by SYNC and SYNC by the clock
(`advance_in_step`), no participant runs ahead of a SYNC that is late.
"""

from __future__ import annotations

import time
from array import array
from dataclasses import dataclass, field
from functools import partial
from typing import Final

#: Part of the cycle, at its end, that is kept for computing and sending the next set points: answers that are not there
#: by then count as missing.
GUARD_FRACTION = 0.3
#: Lateness of so many SYNCs is kept: 16 MB, or more than an hour at 2 ms.
_MOST_KEPT: Final = 1 << 21


class Remembered(array):  # type: ignore[type-arg]
    """Values in the order in which they came. Of many every second is kept, of more every fourth, …, and the largest:
    a run of a night takes no more memory than one of an hour, and has the same percentiles."""

    largest = -(1 << 63)
    every = 1
    seen = 0

    def append(self, value: int, /) -> None:
        """The next one."""
        self.seen += 1
        if value > self.largest:
            self.largest = value
        elif self.seen % self.every:
            return
        super().append(value)
        if len(self) >= _MOST_KEPT:
            del self[::2]
            self.every *= 2
            super().append(self.largest)


@dataclass
class Pacing:
    """State of the real-time pacing; times in ns of the monotonic clock."""

    period_ns: int
    deadline_ns: int = 0  #: when the next SYNC is due; 0 before the first
    missed: int = 0  #: cycles that were not run when they were due: something else was done
    late_set_points: int = 0  #: cycles whose set points came behind their SYNC, or were left out
    lateness_ns: array[int] = field(default_factory=partial(Remembered, "q"))  #: of the SYNCs that were sent


def start(pacing: Pacing, now_ns: int) -> None:
    """The first SYNC is due one period from now."""
    pacing.deadline_ns = now_ns + pacing.period_ns


def advance(pacing: Pacing, sent_ns: int) -> None:
    """Note when the SYNC due at the deadline was sent, and set the next deadline.

    A cycle that comes late by whole periods skips them: they are counted as missed, and the grid of deadlines
    stays where it is, so that one delay does not shift or bunch all that follow.
    """
    late_ns = sent_ns - pacing.deadline_ns
    pacing.lateness_ns.append(late_ns)
    skipped = max(0, late_ns // pacing.period_ns)
    pacing.missed += skipped
    pacing.deadline_ns += (1 + skipped) * pacing.period_ns


def advance_in_step(pacing: Pacing, sent_ns: int) -> None:
    """Note a SYNC to participants that wait for it: deadlines move on by a delay of one period or more.

    None of their cycles is left out; `missed` counts those that the clock would have had. A delay below one period is
    made up for.
    """
    late_ns = sent_ns - pacing.deadline_ns
    pacing.lateness_ns.append(late_ns)
    pacing.missed += max(0, late_ns // pacing.period_ns)
    pacing.deadline_ns += pacing.period_ns + (late_ns if late_ns >= pacing.period_ns else 0)


def bare_loop(period_ns: int, cycles: int) -> Pacing:
    """Wait for so many deadlines and do nothing at them: what the machine itself allows."""
    pacing = Pacing(period_ns)
    start(pacing, time.monotonic_ns())
    for _ in range(cycles):
        advance(pacing, sleep_until(pacing.deadline_ns))
    return pacing


def sleep_until(deadline_ns: int) -> int:
    """Sleep to an absolute time of the monotonic clock; returns the time after it (ns)."""
    while (remaining_ns := deadline_ns - time.monotonic_ns()) > 0:
        time.sleep(remaining_ns * 1e-9)
    return time.monotonic_ns()
