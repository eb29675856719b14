"""Channels of a recording that hold a twin's estimates of its machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Estimate:
    """An estimate's channel, that of its deviation, and its name in the history."""

    value: str
    deviation: str
    quantity: str
    unit: str
