"""Control lock: of any number of viewers one controls, until he releases it or is idle too long."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

#: The seat is free again after this time without an action, and after this time without a connection, s.
IDLE_S: Final = 120.0
LOST_S: Final = 10.0


@dataclass
class _Holder:
    viewer: str
    name: str
    until_s: float
    elapsed_s: float | None = None


class ControlLock:
    """The seat of one bench; `viewer` is what only that viewer knows, `name` what others are shown of him."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._holder: _Holder | None = None

    def _taken(self) -> _Holder | None:
        holder, now_s = self._holder, self._now()
        lost = holder is not None and holder.elapsed_s is not None and now_s - holder.elapsed_s > LOST_S
        if holder is not None and (lost or now_s > holder.until_s):
            self._holder = holder = None
        return holder

    @property
    def name(self) -> str:
        """Name of the controlling viewer; "" without one."""
        holder = self._taken()
        return "" if holder is None else holder.name

    @property
    def left_s(self) -> float | None:
        """Until the seat is free unless its holder does something; None while it is."""
        holder = self._taken()
        return None if holder is None else holder.until_s - self._now()

    def is_of(self, viewer: str) -> bool:
        """True if that viewer controls."""
        holder = self._taken()
        return holder is not None and holder.viewer == viewer

    def take(self, viewer: str, name: str) -> bool:
        """Take or keep control; False where another viewer has it."""
        holder = self._taken()
        if holder is not None and holder.viewer != viewer:
            return False
        self._holder = _Holder(viewer, name, self._now() + IDLE_S)
        return True

    def use(self, viewer: str) -> bool:
        """Something is done by who controls; False where that is not this viewer."""
        return self.is_of(viewer) and self._holder is not None and self.take(viewer, self._holder.name)

    def give_back(self, viewer: str) -> bool:
        """Stand up; False for who does not sit."""
        if not self.is_of(viewer):
            return False
        self._holder = None
        return True

    def leaves(self, viewer: str) -> None:
        """Note that a viewer's connection is lost; he may come back."""
        if self._holder is not None and self._holder.viewer == viewer:
            self._holder.elapsed_s = self._now()

    def comes(self, viewer: str) -> None:
        """A viewer has a connection (again)."""
        if self._holder is not None and self._holder.viewer == viewer:
            self._holder.elapsed_s = None
