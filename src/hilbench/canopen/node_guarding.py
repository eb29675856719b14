"""Node guarding and life guarding, 100Ch and 100Dh, the slave's side (CiA 301, 7.2.8.3.2.1)."""

from __future__ import annotations

from collections.abc import Callable

from hilbench.canopen.data_types import DataType
from hilbench.canopen.identifiers import NmtState
from hilbench.canopen.object_store import ObjectStore

_MS = 1_000_000
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
