"""What has happened, as the page lists it: each event once, and again when it has changed (a ramp goes on)."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Final, Literal

Weight = Literal["note", "warning", "fault", "operator"]

_KEPT: Final = 400


@dataclass(frozen=True)
class Entry:
    """One line: when (experiment time, s; None where it is not known), who or what it is about, what happened."""

    t_s: float | None
    source: str
    text: str
    weight: Weight = "note"


class Events:
    """Last events of a bench, by key; `number` counts changes of the list."""

    def __init__(self) -> None:
        self.number = 0
        self._entries: OrderedDict[object, tuple[int, int, Entry]] = OrderedDict()
        self._known = 0

    def put(self, key: object, entry: Entry) -> None:
        """An event, new or another than it was."""
        place, _, before = self._entries.get(key, (self._known, 0, None))
        if before == entry:
            return
        self._known += before is None
        self.number += 1
        self._entries[key] = (place, self.number, entry)
        if len(self._entries) > _KEPT:
            self._entries.popitem(last=False)

    def add(self, entry: Entry) -> None:
        """An event that stays as it is."""
        self.put(("only", self.number), entry)

    def since(self, number: int) -> list[dict[str, Any]]:
        """Events that have come or changed since the list had that number; `place` is their key."""
        return [{"place": place, **vars(entry)} for place, changed, entry in self._entries.values() if changed > number]
