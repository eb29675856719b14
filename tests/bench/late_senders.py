"""Answers to SYNC that come too late, in lockstep and so each time the same: the bench goes on without them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from hilbench.bench.lifecycle.in_process import InProcess, ServingLink
from hilbench.can.frame import Frame
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle


class LateLink(ServingLink):
    """Holds back frames of some identifiers in a share of the cycles, until just before the next SYNC."""

    late_ids: frozenset[int] = frozenset()
    held_now = False
    _held: list[Frame] = []  # noqa: RUF012 # replaced, never changed

    def receive(self, timeout_s: float) -> list[Frame]:
        frames, held = super().receive(timeout_s), self._held
        if timeout_s <= 0.0:  # before SYNC: what was held back arrives
            self._held = []
            return held + frames
        if not self.held_now:
            return frames
        self._held = held + [frame for frame in frames if frame.can_id in self.late_ids]
        return [frame for frame in frames if frame.can_id not in self.late_ids] or frames[:0]


@contextmanager
def late(share: float, cob_ids: set[int], from_cycle: int, seed: int = 5) -> Iterator[None]:
    """In this share of the cycles the PDOs of these COB-IDs come after the bench has gone on."""
    draw = random.Random(seed)
    links: list[LateLink] = []
    due_of = SyncCycle._due

    def open_link(self: InProcess) -> LateLink:
        links.append(LateLink(self))
        links[-1].late_ids = frozenset(cob_ids)
        return links[-1]

    def due(self: SyncCycle) -> dict[int, ExpectedPdo]:
        found = due_of(self)
        links[-1].held_now = self.timing.cycles >= from_cycle and draw.random() < share
        return {key: pdo for key, pdo in found.items() if not (links[-1].held_now and key in cob_ids)}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(InProcess, "open_link", open_link)
        patch.setattr(SyncCycle, "_due", due)
        yield
