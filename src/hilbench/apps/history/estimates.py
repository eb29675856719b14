"""Channels of a recording that hold a twin's estimates, and history names of places of the machine."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from hilbench.topology.signals import unit_of

#: What is estimated, by its symbol in the names of channels; E is of a web, with the number of the span where there are
#: several, all others are of a shaft.
_ESTIMATED: Final = {
    "E": "youngs_modulus",
    "J": "inertia",
    "coulomb": "coulomb_friction",
    "viscous": "viscous_friction",
}
_CHANNEL: Final = re.compile(rf"({'|'.join(_ESTIMATED)})([1-9]\d*)?_sim_(\w+)")


@dataclass(frozen=True)
class Estimate:
    """An estimate's channel, that of its deviation, and its name in the history."""

    value: str
    deviation: str
    quantity: str
    unit: str


def estimates(channels: Iterable[str]) -> Iterator[Estimate]:
    """Those that a recording has."""
    for name in channels:
        if match := _CHANNEL.fullmatch(name):
            symbol, number, unit = match[1], match[2] or "", match[3]
            of = place({"span": number}) if symbol == "E" else "shaft"
            yield Estimate(name, f"{symbol}{number}_sd_{unit}", f"{of}.{_ESTIMATED[symbol]}_{unit}", unit_of(name))


def place(effect: Mapping[str, Any]) -> str:
    """Place of an effect as a diagnosis writes it, in the path of a quantity."""
    if effect.get("axis"):
        return f"axis{effect['axis']}"
    return f"span{effect['span']}" if effect.get("span") else "web"
