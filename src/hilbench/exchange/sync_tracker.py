"""The SYNCs of a `SyncProducer` as the bench receives them: each in its place between the frames of others."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.identifiers import SYNC
from hilbench.exchange.pacing import GUARD_FRACTION, Pacing
from hilbench.exchange.sync_producer import SyncProducer

#: Part of the cycle, from SYNC on, in which a bench that is late for it still takes its answers: as long as it
#: would wait for them.
_JOIN_FRACTION = 1.0 - GUARD_FRACTION


class _Whose(Enum):
    """A SYNC: one that is waited for, one that is not any more, or not the producer's."""

    OURS, GIVEN_UP, OTHERS = range(3)


@dataclass
class SyncReceived:
    """A SYNC that the bench has waited for, with the frames before and after it.

    `on_wire`: frames before it with the SYNCs that went by; `joined`: it was out before the set points were.
    """

    sync: Frame = field(default_factory=lambda: Frame(SYNC, b""))
    before: list[Frame] = field(default_factory=list)
    behind: list[Frame] = field(default_factory=list)
    on_wire: Sequence[Frame] = ()
    joined: bool = False


class SyncTracker:
    """Finds the SYNCs of a producer among what comes over the bench's own `link`.

    `elapsed_cycles`: number of them for which no cycle was run. `pacing` counts lateness and missed ones.
    """

    def __init__(self, link: Link, producer: SyncProducer, pacing: Pacing) -> None:
        self.elapsed_cycles = 0
        self._link = link
        self._producer = producer
        self._pacing = pacing
        self._come = 0  #: own SYNCs received
        self._run = 0  #: of these, those met or known to have gone by
        self._lost = 0  #: not received in time; they still may be
        self._without = 0
        self._kept: list[Frame] = []  #: from a SYNC on that has come before it was waited for

    @property
    def next_ns(self) -> int:
        """Time at which the next SYNC is due, in ns of the monotonic clock."""
        return self._producer.next_ns

    def meet(self) -> SyncReceived:
        """Wait for the next SYNC; it goes out in any case. Set points have been sent already.

        One sent a short time before is taken as well: its answers are still to come, and only the set
        points are late. Of more than one the last counts, the others have gone by. Raises BusError.
        """
        producer = self._producer
        if not producer.is_running:
            producer.start()
        producer.go_on()
        sent = producer.sent
        since_ns = time.monotonic_ns() - (producer.next_ns - producer.period_ns)
        joins = sent > max(self._run, self._come) and since_ns < _JOIN_FRACTION * producer.period_ns
        awaited = sent if joins else sent + 1
        met = self._wait(awaited)
        met.joined = joins and self._come == awaited
        self._count(joined=met.joined)
        return met

    def answers(self, timeout_s: float) -> list[Frame]:
        """Receive as `Link.receive`, after the SYNC that was met and before the next."""
        others: list[Frame] = []
        frames = [] if self._kept else self._link.receive(timeout_s)
        for at, frame in enumerate(frames):
            if frame.can_id == SYNC and self._come < self._producer.sent:
                self._kept = frames[at:]
                break
            if frame.can_id != SYNC or self._whose() is _Whose.OTHERS:
                others.append(frame)
        return others

    def discard(self, timeout_s: float) -> list[Frame]:
        """Discard frames that wait, or come within a time, between cycles; SYNCs among them are only counted."""
        frames = self._take(timeout_s)
        for frame in frames:
            if frame.can_id == SYNC:
                self._whose()
        return frames

    def _take(self, timeout_s: float) -> list[Frame]:
        kept, self._kept = self._kept, []
        return kept or self._link.receive(timeout_s)

    def _wait(self, wanted: int) -> SyncReceived:
        """Wait until SYNC number `wanted` of ours has come, or must have been lost."""
        producer, others = self._producer, list[Frame]()
        met, split = SyncReceived(), None
        begun_ns, out_ns = time.monotonic_ns(), None
        wire: list[Frame] = []
        while split is None or self._come < wanted:
            for frame in self._take(producer.period_ns * 1e-9):
                whose = self._whose() if frame.can_id == SYNC else _Whose.OTHERS
                if whose is _Whose.OURS:
                    met.sync, met.on_wire, split = frame, wire.copy(), len(others)
                elif whose is _Whose.OTHERS:
                    others.append(frame)
                wire.append(frame)
            if split is not None and self._come >= wanted:
                break
            now_ns = time.monotonic_ns()
            if out_ns is None and producer.sent >= wanted:
                out_ns = now_ns
            if now_ns - begun_ns > 2 * producer.period_ns:
                producer.check((now_ns - begun_ns) * 1e-9)
            if out_ns is not None and now_ns - out_ns > producer.period_ns:
                self._lost += wanted - self._come
                self._come = wanted
                if split is None:
                    met.sync, split = Frame(SYNC, b"", time.time_ns()), 0
        met.before, met.behind = others[:split], others[split:]
        return met

    def _whose(self) -> _Whose:
        """Attribute a received SYNC to its sender."""
        if self._come < self._producer.sent:
            self._come += 1
            return _Whose.OURS
        if self._lost:
            self._lost -= 1
            return _Whose.GIVEN_UP
        return _Whose.OTHERS

    def _count(self, *, joined: bool) -> None:
        producer, pacing = self._producer, self._pacing
        elapsed_cycles, without = self._come - self._run - 1, producer.without
        self._run = self._come
        self.elapsed_cycles += elapsed_cycles
        pacing.missed += elapsed_cycles + without - self._without
        pacing.late_set_points += joined
        pacing.deadline_ns = producer.next_ns
        self._without = without
        producer.read_lateness(pacing.lateness_ns)
