"""Values that a simulated drive's firmware assumes for CiA 402 objects that its EDS file lacks, or gives no value.

A drive whose file has no ramp still ramps, and one without an option code still stops somehow: the values are those
that IEC 61800-7-201 gives as defaults, where it gives any, and moderate ones otherwise. A value in a person's units
(rpm) is converted to the drive's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import pi
from typing import TYPE_CHECKING, Final

from canopen.objectdictionary import ODVariable, datatypes

from hilbench.canopen.object_store import Cell
from hilbench.cia402 import objects
from hilbench.cia402.units import RPM, DriveUnits, ObjectReader, factors_read

if TYPE_CHECKING:
    from hilbench.cia402.axis import AxisDevice

_I8, _I16, _I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
_U8, _U16, _U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
_LARGEST: Final = {_I8: 0x7F, _I16: 0x7FFF, _I32: 0x7FFF_FFFF, _U8: 0xFF, _U16: 0xFFFF, _U32: 0xFFFF_FFFF}

MAX_TORQUE: Final = 3000  #: of 6072h
_Value = int | Callable[[DriveUnits], float]


def _rpm(speed: float) -> Callable[[DriveUnits], float]:
    """A speed, or an acceleration in rpm per second, in the drive's velocity units."""
    return lambda units: speed * RPM / units.velocity_rad_s


#: Type and value of what the firmware uses, by index and sub-index. It may be 0 where "no limit" is meant by it.
_OBJECTS: Final[dict[tuple[int, int], tuple[int, _Value]]] = {
    (objects.ABORT_CONNECTION_OPTION_CODE, 0): (_I16, 1),
    (objects.ERROR_CODE, 0): (_U16, 0),
    (objects.VL_TARGET_VELOCITY, 0): (_I16, 0),
    (objects.VL_VELOCITY_DEMAND, 0): (_I16, 0),
    (objects.VL_VELOCITY_ACTUAL_VALUE, 0): (_I16, 0),
    (objects.VL_VELOCITY_MIN_MAX_AMOUNT, 1): (_U32, 0),
    (objects.VL_VELOCITY_MIN_MAX_AMOUNT, 2): (_U32, 0),
    (objects.VL_VELOCITY_ACCELERATION, 1): (_U32, 1000),
    (objects.VL_VELOCITY_ACCELERATION, 2): (_U16, 1),
    (objects.VL_VELOCITY_DECELERATION, 1): (_U32, 1000),
    (objects.VL_VELOCITY_DECELERATION, 2): (_U16, 1),
    (objects.QUICK_STOP_OPTION_CODE, 0): (_I16, 2),
    (objects.SHUTDOWN_OPTION_CODE, 0): (_I16, 0),
    (objects.DISABLE_OPERATION_OPTION_CODE, 0): (_I16, 1),
    (objects.HALT_OPTION_CODE, 0): (_I16, 1),
    (objects.FAULT_REACTION_OPTION_CODE, 0): (_I16, 2),
    (objects.MODES_OF_OPERATION, 0): (_I8, 0),
    (objects.MODES_OF_OPERATION_DISPLAY, 0): (_I8, 0),
    (objects.POSITION_DEMAND_VALUE, 0): (_I32, 0),
    (objects.POSITION_ACTUAL_VALUE, 0): (_I32, 0),
    (objects.FOLLOWING_ERROR_WINDOW, 0): (_U32, 0xFFFF_FFFF),
    (objects.FOLLOWING_ERROR_TIME_OUT, 0): (_U16, 0),
    (objects.POSITION_WINDOW, 0): (_U32, 0xFFFF_FFFF),
    (objects.POSITION_WINDOW_TIME, 0): (_U16, 0),
    (objects.VELOCITY_DEMAND_VALUE, 0): (_I32, 0),
    (objects.VELOCITY_ACTUAL_VALUE, 0): (_I32, 0),
    (objects.VELOCITY_WINDOW, 0): (_U16, _rpm(10.0)),
    (objects.VELOCITY_WINDOW_TIME, 0): (_U16, 0),
    (objects.VELOCITY_THRESHOLD, 0): (_U16, _rpm(5.0)),
    (objects.VELOCITY_THRESHOLD_TIME, 0): (_U16, 0),
    (objects.TARGET_TORQUE, 0): (_I16, 0),
    (objects.MAX_TORQUE, 0): (_U16, MAX_TORQUE),
    (objects.TORQUE_DEMAND, 0): (_I16, 0),
    (objects.TORQUE_ACTUAL_VALUE, 0): (_I16, 0),
    (objects.TARGET_POSITION, 0): (_I32, 0),
    (objects.HOME_OFFSET, 0): (_I32, 0),
    (objects.SOFTWARE_POSITION_LIMIT, 1): (_I32, 0),
    (objects.SOFTWARE_POSITION_LIMIT, 2): (_I32, 0),
    (objects.MAX_PROFILE_VELOCITY, 0): (_U32, 0),
    (objects.MAX_MOTOR_SPEED, 0): (_U32, 0),
    (objects.PROFILE_VELOCITY, 0): (_U32, _rpm(500.0)),
    (objects.END_VELOCITY, 0): (_U32, 0),
    (objects.PROFILE_ACCELERATION, 0): (_U32, _rpm(5_000.0)),
    (objects.PROFILE_DECELERATION, 0): (_U32, _rpm(5_000.0)),
    (objects.QUICK_STOP_DECELERATION, 0): (_U32, _rpm(10_000.0)),
    (objects.TORQUE_SLOPE, 0): (_U32, 10_000),
    (objects.HOMING_METHOD, 0): (_I8, 0),
    (objects.HOMING_SPEEDS, 1): (_U32, _rpm(100.0)),
    (objects.HOMING_SPEEDS, 2): (_U32, _rpm(10.0)),
    (objects.HOMING_ACCELERATION, 0): (_U32, _rpm(5_000.0)),
    (objects.VELOCITY_OFFSET, 0): (_I32, 0),
    (objects.TORQUE_OFFSET, 0): (_I16, 0),
    (objects.TOUCH_PROBE_FUNCTION, 0): (_U16, 0),
    (objects.TOUCH_PROBE_STATUS, 0): (_U16, 0),
    **{(index, 0): (_I32, 0) for index in objects.TOUCH_PROBE_POSITIONS},
    (objects.INTERPOLATION_DATA_RECORD, 1): (_I32, 0),
    (objects.INTERPOLATION_TIME_PERIOD, 1): (_U8, 1),
    (objects.INTERPOLATION_TIME_PERIOD, 2): (_I8, -3),
    (objects.FOLLOWING_ERROR_ACTUAL_VALUE, 0): (_I32, 0),
    (objects.DIGITAL_INPUTS, 0): (_U32, 0),
    (objects.TARGET_VELOCITY, 0): (_I32, 0),
}


def cell_of(device: AxisDevice, units: DriveUnits, index: int, sub: int = 0) -> Cell:
    """The cell of an object that the firmware uses: the device's, or where the EDS lacks it one that no bus reaches.

    An object of the device for which the file names no value starts with the assumed one.
    """
    data_type, value = _OBJECTS[index, sub]
    number = min(round(value(units)), _LARGEST[data_type]) if callable(value) else value
    if device.has(index, sub):
        cell = device.cell(index, sub)
        if cell.variable.value is None and cell.variable.default is None:
            cell.start_with(number)
        return cell
    variable = ODVariable(f"{index:04X}h", index, sub)
    variable.data_type, variable.default = data_type, number
    return Cell(variable)


#: Defaults of a drive that does not give them.
_INCREMENTS_PER_TURN, _RATED_TORQUE_NM = 4096, 1.0


def assumed_units(read: ObjectReader, given: Mapping[str, float], place: str) -> tuple[DriveUnits, list[str]]:
    """Units of a simulated drive, and the assumptions made for them, one line each.

    One given by neither objects nor `given` (as in `DriveUnits.from_objects`) is 4096 increments a turn, rpm, 1 N·m.
    """
    assumed = {
        "position_rad": (2.0 * pi / _INCREMENTS_PER_TURN, f"{_INCREMENTS_PER_TURN} position units a turn of the motor"),
        "rated_torque_Nm": (_RATED_TORQUE_NM, f"a rated torque of {_RATED_TORQUE_NM:g} N·m"),
        "velocity_rad_s": (RPM, "velocities in rpm"),
    }
    known, notes = dict(given), []
    for name, (value, text) in assumed.items():  # velocity last: its unit may be increments per second
        factor, problem = factors_read(read, known, place)[name]
        if factor is None:
            known[name] = value
            notes.append(f"{problem}: {text}")
    return DriveUnits.from_objects(read, known, place), notes
