"""Receivers of an identifier on an emulated wire."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, Protocol, TypeVar

from hilbench.can.arbitration import accepts

_KNOWN_IDENTIFIERS = 4096


class _Filtered(Protocol):
    @property
    def filters(self) -> Sequence[tuple[int, int]] | None: ...


Listener = TypeVar("Listener", bound=_Filtered)


class Listeners(Generic[Listener]):
    """Cache of the stations of `present` whose filters let an identifier pass, until `forget`."""

    def __init__(self, present: Callable[[], Iterable[Listener]]) -> None:
        self._present = present
        self._known: dict[int, list[Listener]] = {}

    def of(self, can_id: int) -> list[Listener]:
        """Receivers of `can_id` (with its flag bits)."""
        found = self._known.get(can_id)
        if found is None:
            if len(self._known) >= _KNOWN_IDENTIFIERS:
                self._known.clear()
            found = self._known[can_id] = [one for one in self._present() if accepts(one.filters, can_id)]
        return found

    def forget(self) -> None:
        """Forget receivers: a station has joined or left, or changed its filters."""
        self._known.clear()
