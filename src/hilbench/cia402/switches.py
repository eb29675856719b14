"""Inputs of a simulated drive in addition to its encoder: limit and home switches, probe inputs, the index pulse."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, inf, pi
from typing import Final

#: Bits of 60FDh (digital inputs).
INPUT_NEGATIVE_LIMIT: Final = 1 << 0
INPUT_POSITIVE_LIMIT: Final = 1 << 1
INPUT_HOME: Final = 1 << 2
#: Bits 16 and above are the maker's: here the inputs of touch probe 1 and 2.
INPUT_PROBES: Final = (1 << 16, 1 << 17)

_TURN_RAD: Final = 2.0 * pi


@dataclass(frozen=True)
class Zone:
    """Zone in which a switch is active: motor angles in rad, both ends included."""

    from_rad: float
    to_rad: float

    def holds(self, position_rad: float) -> bool:
        """True if the switch is active at this angle."""
        return self.from_rad <= position_rad <= self.to_rad


@dataclass(frozen=True)
class Switches:
    """Switches along a motor's travel; the encoder's index is at every full turn."""

    negative_limit: Zone = Zone(-inf, -inf)
    positive_limit: Zone = Zone(inf, inf)
    home: Zone = Zone(inf, inf)
    probes: tuple[Zone, Zone] = (Zone(inf, inf), Zone(inf, inf))

    def inputs(self, position_rad: float) -> int:
        """Digital inputs 60FDh with the motor at this angle."""
        bits = 0
        for zone, bit in (
            (self.negative_limit, INPUT_NEGATIVE_LIMIT),
            (self.positive_limit, INPUT_POSITIVE_LIMIT),
            (self.home, INPUT_HOME),
            *zip(self.probes, INPUT_PROBES, strict=True),
        ):
            bits |= bit if zone.holds(position_rad) else 0
        return bits


def next_index_rad(position_rad: float, direction: int) -> float:
    """Next index pulse from an angle, forward (1) or backward (-1); not the one at the angle itself."""
    turns = position_rad / _TURN_RAD
    return _TURN_RAD * (floor(turns) + 1 if direction > 0 else ceil(turns) - 1)


def index_between_rad(before_rad: float, after_rad: float) -> float | None:
    """Last index pulse passed from one angle to the other; None: none was."""
    if after_rad > before_rad:
        found = _TURN_RAD * floor(after_rad / _TURN_RAD)
        return found if found > before_rad else None
    found = _TURN_RAD * ceil(after_rad / _TURN_RAD)
    return found if found < before_rad else None
