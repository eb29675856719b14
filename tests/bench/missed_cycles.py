"""SYNCs that a bench in real time would have been too late to send, in lockstep and so each time the same.

What follows is what it is in real time: the bench counts them as missed, the plant goes on meanwhile with the set
points that it has, and the twin hears from its clock that they are lacking.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.hardware.plant_time import BySync
from hilbench.twin.bus_clock import SyncArrival
from hilbench.twin.process import TwinApplication


class _Counted:
    """The twin's clock, which has seen so many cycles since the last SYNC as there were."""

    missed = 0
    apart = False

    def sync_received(self, behind: int) -> SyncArrival:
        """A cycle is as long as the config says."""
        return SyncArrival(self.missed, None, were_apart=False, apart=False)


@contextmanager
def missed(share: float, from_cycle: int, longest: int = 5, seed: int = 3) -> Iterator[list[int]]:
    """This share of the plant's cycles is missed, one to `longest` in a row; yields the SYNCs before which some were,
    one entry for each cycle."""
    draw = random.Random(seed)
    counted = _Counted()
    before: list[int] = []
    exchange, before_sync, made = SyncCycle._exchange, BySync.before_sync, TwinApplication.__init__

    def exchanged(self: SyncCycle, outgoing: Any) -> Any:
        hit = self.timing.cycles >= from_cycle and draw.random() < 2.0 * share / (1.0 + longest)
        counted.missed = draw.randint(1, longest) if hit else 0
        self.pacing.missed += counted.missed
        before.extend([self.timing.cycles + 1] * counted.missed)
        return exchange(self, outgoing)

    def gone(self: BySync, behind: int) -> int:
        return before_sync(self, behind) + counted.missed * self._cycle

    def make(self: TwinApplication, *of: Any) -> None:
        made(self, *of)
        self._clock = counted  # type: ignore[assignment]

    with pytest.MonkeyPatch.context() as patch:
        # A cycle before which some were missed is none of the plain ones that run compiled.
        patch.setattr(SyncCycle, "fits_fast_path", False)
        patch.setattr(SyncCycle, "_exchange", exchanged)
        patch.setattr(BySync, "before_sync", gone)
        patch.setattr(TwinApplication, "__init__", make)
        yield before
