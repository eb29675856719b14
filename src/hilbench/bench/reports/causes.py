"""Possible causes of a fault: lasting conditions, in the order in which they began.

A fault names what broke in the end. What was wrong before it is often the better place to look: so such a
condition is reported in each cycle in which it holds, and the fault that ends the run names the first of them.
"""

from __future__ import annotations

from dataclasses import dataclass

#: A condition that has not held for this time before the fault is no cause of it; later it counts as a new one.
_HELD_S = 2.0


@dataclass(slots=True)
class _Condition:
    since_s: float
    until_s: float
    text: str


class Causes:
    """Conditions of one run by kind; times are experiment time, s."""

    def __init__(self) -> None:
        self._conditions: dict[str, _Condition] = {}

    def holds(self, time_s: float, kind: str, text: str) -> None:
        """The condition `kind` holds now; `text` describes it as it is now."""
        known = self._conditions.get(kind)
        if known is None or time_s - known.until_s > _HELD_S:
            self._conditions[kind] = _Condition(time_s, time_s, text)
        else:
            known.until_s, known.text = time_s, text

    def first(self, time_s: float, fault: str) -> str:
        """Condition that began first of those that held until just before `time_s`, with its time; "" for none, and
        where the text of the `fault` has it already."""
        lasting = [condition for condition in self._conditions.values() if time_s - condition.until_s <= _HELD_S]
        if not lasting:
            return ""
        first = min(lasting, key=lambda condition: condition.since_s)
        return "" if first.text in fault else f"from t = {first.since_s:.3f} s on: {first.text}"
