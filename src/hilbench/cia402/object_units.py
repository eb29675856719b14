"""SI units of single objects: one device unit of an object, where its standard defines it."""

from __future__ import annotations

from typing import Final

from hilbench.cia402 import objects
from hilbench.cia402.axis import of_first_axis
from hilbench.cia402.units import RPM, DriveUnits

#: Objects in the drive's own units: the unit's factor in `DriveUnits`, and its name in SI.
_OF_DRIVE: Final = {
    **dict.fromkeys(
        (
            objects.POSITION_DEMAND_VALUE,
            objects.POSITION_ACTUAL_VALUE,
            objects.FOLLOWING_ERROR_WINDOW,
            objects.TARGET_POSITION,
            objects.HOME_OFFSET,
            objects.FOLLOWING_ERROR_ACTUAL_VALUE,
        ),
        ("position_rad", "rad"),
    ),
    **dict.fromkeys(
        (
            objects.VELOCITY_DEMAND_VALUE,
            objects.VELOCITY_ACTUAL_VALUE,
            objects.VELOCITY_WINDOW,
            objects.VELOCITY_THRESHOLD,
            objects.MAX_PROFILE_VELOCITY,
            objects.VELOCITY_OFFSET,
            objects.TARGET_VELOCITY,
        ),
        ("velocity_rad_s", "rad/s"),
    ),
    **dict.fromkeys(
        (objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION),
        ("acceleration_rad_s2", "rad/s²"),
    ),
    **dict.fromkeys(
        (
            objects.TARGET_TORQUE,
            objects.MAX_TORQUE,
            objects.TORQUE_DEMAND,
            objects.TORQUE_ACTUAL_VALUE,
            objects.TORQUE_OFFSET,
        ),
        ("torque_Nm", "N·m"),
    ),
}
#: Objects whose unit does not depend on the drive.
_FIXED: Final = {
    0x1006: (1e-6, "s"),
    0x1017: (1e-3, "s"),
    objects.FOLLOWING_ERROR_TIME_OUT: (1e-3, "s"),
    objects.VELOCITY_WINDOW_TIME: (1e-3, "s"),
    objects.VELOCITY_THRESHOLD_TIME: (1e-3, "s"),
    objects.MOTOR_RATED_CURRENT: (1e-3, "A"),
    objects.MOTOR_RATED_TORQUE: (1e-3, "N·m"),
    objects.MAX_MOTOR_SPEED: (RPM, "rad/s"),
}


def has_drive_unit(index: int) -> bool:
    """True if an object's unit is one of the drive's own."""
    return of_first_axis(index) in _OF_DRIVE


def si_unit(index: int, units: DriveUnits | None) -> tuple[float, str] | None:
    """One unit of the object in SI (motor side), and that unit's name; None where it is not defined.

    `units` are the drive's; without them only objects with a unit of their own have one.
    """
    index = of_first_axis(index)
    if index in _FIXED:
        return _FIXED[index]
    if units is None or index not in _OF_DRIVE:
        return None
    factor, unit = _OF_DRIVE[index]
    return getattr(units, factor), unit
