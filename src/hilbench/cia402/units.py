"""Device units of a CiA-402 drive and SI units at the motor shaft.

The factors come from the drive's own objects, or from the configuration for drives that lack them:

- position: 608Fh encoder increments per motor revolution; with a feed constant (6092h) instead in its units per
  revolution of the shaft after the gear 6091h, unless 60A8h selects increments;
- velocity: 60A9h (CiA 303-2 notation), at the shaft after the gear 6091h;
- acceleration: velocity units per second;
- torque: per mille of the rated torque 6076h (mN·m).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from typing import Final

from hilbench.cia402 import objects
from hilbench.errors import UnusableInputError

#: Reads an object's value, ``read(index, sub)``; None when the device does not have the object.
ObjectReader = Callable[[int, int], int | float | None]

#: rad/s of one revolution per minute, the unit of 6080h.
RPM: Final = 2.0 * pi / 60.0
#: Numerator and denominator codes of SI unit objects that a velocity can have, in rad/s.
_VELOCITY_CODES: Final = {
    0xB447: RPM,  # revolutions per minute
    0xB403: 2.0 * pi,  # revolutions per second
    0x1003: 1.0,  # radians per second
}
_INCREMENTS: Final = 0xB5
_INCREMENTS_PER_SECOND: Final = 0xB503

_WRAP: Final = 1 << 32
_HALF: Final = 1 << 31


@dataclass(frozen=True)
class DriveUnits:
    """One device unit in SI units, motor side."""

    position_rad: float  #: rad per position unit (6064h)
    velocity_rad_s: float  #: rad/s per velocity unit (606Ch, 60FFh)
    torque_Nm: float  #: N·m per torque unit (6071h, 6077h), a thousandth of the rated torque

    @property
    def acceleration_rad_s2(self) -> float:
        """rad/s² per acceleration unit (6083h to 6085h): one velocity unit per second."""
        return self.velocity_rad_s

    @classmethod
    def from_objects(
        cls, read: ObjectReader, overrides: Mapping[str, float] | None = None, place: str = ""
    ) -> DriveUnits:
        """Read the factors through `read`, except those that `overrides` gives.

        Keys of `overrides`: position_rad, velocity_rad_s, rated_torque_Nm. Raises UnusableInputError, at `place`,
        when neither the device nor the configuration gives a factor.
        """
        given = dict(overrides or {})
        unknown = sorted(given.keys() - {"position_rad", "velocity_rad_s", "rated_torque_Nm"})
        if unknown:
            raise UnusableInputError(
                place, f"unknown unit '{unknown[0]}', expected position_rad, velocity_rad_s or rated_torque_Nm"
            )
        factors = factors_read(read, given, place)
        missing = [
            f"{problem}, expected it or the unit '{name}'"
            for name, (factor, problem) in factors.items()
            if factor is None
        ]
        if missing:
            raise UnusableInputError(place, "; ".join(missing))
        position, rated, velocity = (factor or 0.0 for factor, _ in factors.values())
        return cls(position, velocity, rated / 1000.0)


def factors_read(
    read: ObjectReader, given: Mapping[str, float], place: str = ""
) -> dict[str, tuple[float | None, str]]:
    """Find position_rad, velocity_rad_s and rated_torque_Nm from `given` or the objects.

    None for one that is not given, with the problem of its object. Raises UnusableInputError, at `place`, for a
    velocity unit that is not known.
    """
    gear = _ratio(read, objects.GEAR_RATIO) or 1.0
    position = given.get("position_rad") or _position_unit(read, gear)
    rated = given.get("rated_torque_Nm") or (read(objects.MOTOR_RATED_TORQUE, 0) or 0) / 1000.0
    velocity = given.get("velocity_rad_s") or _velocity_unit(read, gear, position, place)
    return {
        "position_rad": (position, "608Fh is absent or 0, and so is 6092h"),
        "rated_torque_Nm": (rated or None, "6076h is absent or 0"),
        "velocity_rad_s": (velocity, "60A9h is absent"),
    }


def _ratio(read: ObjectReader, index: int) -> float | None:
    """Sub-index 1 by sub-index 2 of a pair object; None when it is absent or not a ratio."""
    numerator, denominator = read(index, 1), read(index, 2)
    return numerator / denominator if numerator and denominator else None


def _position_unit(read: ObjectReader, gear: float) -> float | None:
    feed = _ratio(read, objects.FEED_CONSTANT)  # units per shaft revolution
    in_increments = (int(read(objects.SI_UNIT_POSITION, 0) or 0) >> 16) & 0xFF == _INCREMENTS
    if feed is not None and not in_increments:
        return 2.0 * pi * gear / feed
    increments = _ratio(read, objects.POSITION_ENCODER_RESOLUTION)  # increments per motor revolution
    return None if increments is None else 2.0 * pi / increments


def _velocity_unit(read: ObjectReader, gear: float, position_rad: float | None, place: str) -> float | None:
    raw = read(objects.SI_UNIT_VELOCITY, 0)
    if raw is None:
        return None
    code = int(raw)
    exponent = (code >> 24) - 256 if code >> 31 else code >> 24  # a signed byte
    unit = (code >> 8) & 0xFFFF
    if unit == _INCREMENTS_PER_SECOND:
        return None if position_rad is None else position_rad * 10.0**exponent
    if unit not in _VELOCITY_CODES:
        raise UnusableInputError(
            place,
            f"velocity unit 60A9h = {code:08X}h is not one of rpm (xxB44700h), 1/s (xxB40300h), rad/s (xx100300h), "
            "increments/s (xxB50300h); expected one of these or the unit 'velocity_rad_s'",
        )
    return _VELOCITY_CODES[unit] * 10.0**exponent * gear


def wrap_int32(value: int) -> int:
    """`value` as a 32-bit counter shows it."""
    return (value + _HALF) % _WRAP - _HALF


class UnwrappingCounter:
    """A 32-bit counter that wraps, unwrapped to a value without jumps.

    Right as long as two readings are less than 2^31 units apart (2048 motor revolutions at 2^20 increments).
    """

    def __init__(self) -> None:
        #: The unwrapped value after the last reading; None before the first.
        self.value: int | None = None
        self.last = 0  #: the last reading

    def counted_until(self, value: int, last: int) -> None:
        """Account for readings followed by the fast path: the unwrapped value, and the last reading."""
        self.value, self.last = value, last

    def update(self, reading: int) -> int:
        """The unwrapped value after a new reading; the first reading is taken as it is."""
        if self.value is None:
            self.value = reading
        else:
            self.value += wrap_int32(reading - self.last)
        self.last = reading
        return self.value
