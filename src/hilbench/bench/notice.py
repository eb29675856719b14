"""Something an operator must know of a run that goes on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Notice:
    """When (experiment time), where, what."""

    time_s: float
    source: str
    text: str
