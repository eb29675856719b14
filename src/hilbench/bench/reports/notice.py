"""Notices to the operator of a running run: counted and bounded, however often they occur.

Per source and kind the first and the last occurrence are kept, and how many there were. It is
published at once the first time, and then ever more seldom: a flood of alarms hides no other alarm, and takes no time
of the cycle.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

#: Kinds distinguished per source; any beyond them are counted as one kind more.
MOST_KINDS = 16
_BEYOND = f"more than {MOST_KINDS} kinds"
#: Occurrences of one kind are published again after this time, and then after twice the previous time.
_AGAIN_S = 1.0
#: Most lines published in one cycle; others are published when they occur again, or in the result.
_MOST_LINES = 4
_NUMBERS = re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?")


@dataclass(slots=True)
class Notice:
    """One kind of thing that one source has reported: its first and last occurrence (experiment time, s), how often."""

    time_s: float
    source: str
    text: str
    last_time_s: float
    last_text: str
    count: int
    next_s: float = 0.0  #: when the next occurrence is published
    pause_s: float = _AGAIN_S


class Notices:
    """The notices of one run, in the order of their first occurrence; `publish` gets the lines for the operator."""

    def __init__(self, publish: Callable[[str], None]) -> None:
        self._publish = publish
        self._found: dict[tuple[str, str], Notice] = {}
        self._kinds: dict[str, int] = {}
        self._cycle_s: float | None = None
        self._lines = 0

    def __iter__(self) -> Iterator[Notice]:
        return iter(self._found.values())

    def __len__(self) -> int:
        return len(self._found)

    def note(self, time_s: float, source: str, text: str, *, kind: str = "", count: int = 1) -> None:
        """Something has happened at `time_s`, `count` times. `kind`: what counts as the same thing; by default that
        is the text without its numbers."""
        key = source, kind or _NUMBERS.sub("#", text)
        if key not in self._found and self._kinds.get(source, 0) >= MOST_KINDS:
            key = source, _BEYOND
        found = self._found.get(key)
        if found is None:
            self._kinds[source] = self._kinds.get(source, 0) + 1
            first = f"{_BEYOND}, the next: {text}" if key[1] == _BEYOND else text
            self._found[key] = found = Notice(time_s, source, first, time_s, text, count, next_s=time_s)
        else:
            found.last_time_s, found.last_text = time_s, text
            found.count += count
        self._publish_if_due(time_s, found)

    def _publish_if_due(self, time_s: float, found: Notice) -> None:
        if time_s != self._cycle_s:
            self._cycle_s, self._lines = time_s, 0
        if time_s < found.next_s or self._lines >= _MOST_LINES:
            return
        self._lines += 1
        found.next_s = time_s + found.pause_s
        found.pause_s *= 2.0
        times = "" if found.count == 1 else f" ({found.count} times by now)"
        self._publish(f"t = {time_s:.3f} s: {found.source}: {found.last_text}{times}")
