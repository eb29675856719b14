"""Heartbeat producer 1017h and consumers 1016h; node guarding and life guarding, 100Ch and 100Dh (CiA 301, 7.2.8.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from hilbench.canopen.data_types import DataType
from hilbench.canopen.identifiers import NmtState
from hilbench.canopen.object_store import INCOMPATIBLE, Cell, ObjectStore, SdoAbort

_MS = 1_000_000


class HeartbeatProducer:
    """Sends the NMT state every 1017h ms."""

    def __init__(self, store: ObjectStore, now_ns: Callable[[], int]) -> None:
        self._period = store.conditional(0x1017, DataType.UNSIGNED16, 0)
        self._now_ns = now_ns
        self.next_ns = 0  #: time at which the next one is due
        self._period.on_write = self._restart

    @property
    def period_ns(self) -> int:
        """Period in ns; 0: none is sent."""
        return int(self._period.value * _MS)

    def sent_until(self, next_ns: int) -> None:
        """Account for heartbeats sent by the fast path; the next one is due at `next_ns`."""
        self.next_ns = next_ns

    def rephase(self) -> None:
        """Count the period from now."""
        self.next_ns = self._now_ns() + self._period.value * _MS

    def due(self, now_ns: int) -> bool:
        """True if a heartbeat is to be sent now; the next one is due a period later."""
        period_ns = self._period.value * _MS
        if period_ns == 0 or now_ns < self.next_ns:
            return False
        self.next_ns = max(self.next_ns + period_ns, now_ns)
        return True

    def _restart(self, period_ms: int) -> None:
        self.next_ns = self._now_ns() + period_ms * _MS


@dataclass
class _Watch:
    deadline_ns: int | None = None  #: None until the first heartbeat
    lost: bool = False


class HeartbeatConsumer:
    """Watches the nodes in 1016h; `on_lost(node)` and `on_back(node)` are called on changes."""

    def __init__(
        self,
        store: ObjectStore,
        now_ns: Callable[[], int],
        on_lost: Callable[[int], None],
        on_back: Callable[[int], None],
    ) -> None:
        self._entries = [store.cell(0x1016, n) for n in range(1, 128) if (0x1016, n) in store]
        self._now_ns = now_ns
        self._on_lost = on_lost
        self._on_back = on_back
        self._watches: dict[int, _Watch] = {}
        for entry in self._entries:
            entry.on_write = partial(self._check, entry)

    def times_ns(self) -> dict[int, int]:
        """Consumer heartbeat time by node id, of the entries in use."""
        return {
            entry.value >> 16 & 0x7F: (entry.value & 0xFFFF) * _MS
            for entry in self._entries
            if entry.value & 0xFFFF and 1 <= entry.value >> 16 & 0xFF <= 127
        }

    def received(self, node_id: int) -> None:
        """A heartbeat of a node has come."""
        time_ns = self.times_ns().get(node_id)
        if time_ns is None:
            return
        watch = self._watches.setdefault(node_id, _Watch())
        watch.deadline_ns = self._now_ns() + time_ns
        if watch.lost:
            watch.lost = False
            self._on_back(node_id)

    def rephase(self) -> None:
        """Give every watched node its full time from now on."""
        for node_id, time_ns in self.times_ns().items():
            watch = self._watches.get(node_id)
            if watch is not None and watch.deadline_ns is not None:
                watch.deadline_ns = self._now_ns() + time_ns

    def quiet_until_ns(self) -> int | None:
        """Time until which no time-out can expire, even without a heartbeat; None: for ever."""
        running = [watch.deadline_ns for watch in self._watches.values() if not watch.lost]
        return min((deadline_ns for deadline_ns in running if deadline_ns is not None), default=None)

    def poll(self, now_ns: int) -> None:
        """Report the nodes whose heartbeat time-out has expired."""
        for node_id, watch in self._watches.items():
            if watch.deadline_ns is not None and not watch.lost and now_ns > watch.deadline_ns:
                watch.lost = True
                self._on_lost(node_id)

    def reset(self) -> None:
        """Watch no node until its heartbeat is received again."""
        self._watches.clear()

    def _check(self, own: Cell, value: int) -> None:
        node_id = value >> 16 & 0xFF
        others = (entry.value for entry in self._entries if entry is not own)
        if value & 0xFFFF and any(other & 0xFFFF and other >> 16 & 0xFF == node_id for other in others):
            raise SdoAbort(INCOMPATIBLE)
        for changed in {node_id, own.value >> 16 & 0xFF}:
            self._forget(changed)

    def _forget(self, node_id: int) -> None:
        """Stop watching a node until its heartbeat is received again; one that is not watched is not missed."""
        watch = self._watches.pop(node_id, None)
        if watch is not None and watch.lost:
            self._on_back(node_id)


_TOGGLE = 0x80


class NodeGuarding:
    """Answers the master's remote frames, and supervises them: `on_lost()` and `on_back()` are called on changes.

    A device without 100Ch is not guarded. The life time, guard time by life time factor, begins with the first remote
    frame.
    """

    def __init__(
        self,
        store: ObjectStore,
        now_ns: Callable[[], int],
        on_lost: Callable[[], None],
        on_back: Callable[[], None],
    ) -> None:
        self.offered = (0x100C, 0) in store
        self._guard_time = store.conditional(0x100C, DataType.UNSIGNED16, 0)
        self._factor = store.conditional(0x100D, DataType.UNSIGNED8, 0)
        self._now_ns = now_ns
        self._on_lost = on_lost
        self._on_back = on_back
        self.reset()

    def reset(self) -> None:
        """Reset at boot-up: the first answer's toggle bit is 0, and supervision starts with the first remote frame."""
        self._toggle = 0
        self._received_ns: int | None = None
        self._lost = False

    @property
    def watches(self) -> bool:
        """True if a silent master is detected."""
        return self._received_ns is not None and self._life_time_ns > 0

    @property
    def _life_time_ns(self) -> int:
        return int(self._guard_time.value * self._factor.value * _MS)

    def answer(self, state: NmtState) -> bytes:
        """Answer to a remote frame of the master."""
        self._received_ns = self._now_ns()
        if self._lost:
            self._lost = False
            self._on_back()
        reply = bytes([state.value | self._toggle])
        self._toggle ^= _TOGGLE
        return reply

    def poll(self, now_ns: int) -> None:
        """Report the master when the life time has expired."""
        received_ns = self._received_ns
        if received_ns is not None and self.watches and not self._lost and now_ns - received_ns > self._life_time_ns:
            self._lost = True
            self._on_lost()
