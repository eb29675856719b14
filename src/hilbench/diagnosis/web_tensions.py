"""Channels of measured web tensions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from hilbench.results.recording import Recording

_TENSION: Final = "F_meas_N"


def tension_channels(recording: Recording, spans: int) -> dict[int, str]:
    """Channels of measured tensions by span; that of the first is without its number where there is one span."""
    found: dict[int, str] = {}
    for span in range(1, spans + 1):
        names = [name for name in _usual_first(span, spans) if name in recording]
        if names:
            found[span] = names[0]
    return found


def _usual_first(span: int, spans: int) -> list[str]:
    """Channels that may have the measured tension of a span, the usual one first."""
    numbered = f"F{span}_meas_N"
    if span > 1:
        return [numbered]
    return [_TENSION, numbered] if spans == 1 else [numbered, _TENSION]


def tension_names(spans: Iterable[int]) -> list[str]:
    """What the tensions of these spans are called in a diagnosis, in the order of the spans."""
    return [_TENSION if span == 1 else f"F{span}_meas_N" for span in sorted(spans)]
