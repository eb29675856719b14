"""A parameter that is estimated beside the one that is looked for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Not `separable`: the data don't tell it from what is looked for, its prior value is held."""

    name: str  #: with its unit
    value: float
    deviation: float
    separable: bool
