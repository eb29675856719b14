"""Samples as messages: one for each group of signals, as JSON, made from the registry of signals."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from hilbench.topology.signal_kinds import TIME, Signal


@dataclass(frozen=True)
class Group:
    """Signals of one message, and the place of each in a row."""

    name: str
    signals: Sequence[Signal]
    places: Sequence[int]

    @property
    def topic(self) -> str:
        """``/measured``."""
        return f"/{self.name}"

    def schema(self) -> dict[str, Any]:
        """JSON Schema of its messages, with units; a value that is not finite is null."""
        return {
            "type": "object",
            "title": f"hilbench.{self.name}",
            "properties": {
                TIME: {"type": "number", "unit": "s", "description": "experiment time, s"},
                **{
                    each.name: {
                        "type": "integer" if each.integer else "number",
                        "unit": each.unit or "1",
                        "description": f"{each.description}{f', {each.unit}' if each.unit else ''}",
                    }
                    for each in self.signals
                },
            },
        }

    def values(self, row: Sequence[float], t_s: float) -> dict[str, float | int | None]:
        """A message, as a program holds it."""
        found: dict[str, float | int | None] = {TIME: t_s}
        for signal, place in zip(self.signals, self.places, strict=True):
            value = row[place]
            found[signal.name] = None if not isfinite(value) else int(value) if signal.integer else value
        return found

    def text(self, row: Sequence[float], t_s: float) -> bytes:
        """Message as JSON; numbers as the shortest text that reads back as the same binary64."""
        return json.dumps(self.values(row, t_s), separators=(",", ":")).encode()


def groups_of(signals: Sequence[Signal]) -> list[Group]:
    """The groups of a bench's signals, time in each of them."""
    places = {signal.name: place for place, signal in enumerate(signals)}
    named = dict.fromkeys(signal.group for signal in signals if signal.name != TIME)
    return [
        Group(name, found, [places[signal.name] for signal in found])
        for name in named
        if (found := [signal for signal in signals if signal.group == name and signal.name != TIME])
    ]


def time_place(signals: Sequence[Signal]) -> int:
    """Place of the time in a row."""
    return next(place for place, signal in enumerate(signals) if signal.name == TIME)


def rows_of(data: bytes, width: int) -> Iterator[Sequence[float]]:
    """The rows of a piece of packed samples (binary64, in the machine's order)."""
    values = memoryview(data).cast("d")
    for at in range(0, len(values), width):
        yield values[at : at + width].tolist()
