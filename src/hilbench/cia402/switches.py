"""What a simulated drive sees beside its encoder: limit switches, the home switch, probe inputs, the index pulse."""

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
    """Where a switch is active: motor angles in rad, both ends included."""

    from_rad: float
    to_rad: float

    def holds(self, position_rad: float) -> bool:
        """Whether the switch is active there."""
        return self.from_rad <= position_rad <= self.to_rad


@dataclass(frozen=True)
class Switches:
    """The switches along the way of a motor; the encoder's index is at every full turn."""

    negative_limit: Zone = Zone(-inf, -inf)
    positive_limit: Zone = Zone(inf, inf)
    home: Zone = Zone(inf, inf)
    probes: tuple[Zone, Zone] = (Zone(inf, inf), Zone(inf, inf))

    def inputs(self, position_rad: float) -> int:
        """60FDh with the motor there."""
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
    """The index pulse that comes next from there, forward (1) or backward (-1); not the one where the motor is."""
    turns = position_rad / _TURN_RAD
    return _TURN_RAD * (floor(turns) + 1 if direction > 0 else ceil(turns) - 1)


def index_between_rad(before_rad: float, after_rad: float) -> float | None:
    """The last index pulse that was passed on the way from one angle to the other; None: none was."""
    if after_rad > before_rad:
        found = _TURN_RAD * floor(after_rad / _TURN_RAD)
        return found if found > before_rad else None
    found = _TURN_RAD * ceil(after_rad / _TURN_RAD)
    return found if found < before_rad else None
