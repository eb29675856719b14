"""Nuisance parameter, estimated in addition to the one that is wanted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Nuisance parameter estimate. Not `separable`: the data don't separate it from the wanted one, its prior
    is held."""

    name: str  #: with its unit
    value: float
    deviation: float
    separable: bool
