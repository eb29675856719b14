"""Set-up work with one drive by SDO: positions, homing, velocity and torque, within limits.

No SYNC, no PDO, no bench: the drive is enabled in a profile mode of CiA 402 and moves. The objects needed are
looked up in its EDS file and in 6502h, and missing ones are named in errors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, isnan
from typing import Final

from hilbench.cia402 import objects
from hilbench.cia402.manual import ManualDrive
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    STATUS_MODE_12,
    STATUS_MODE_13,
    STATUS_TARGET_REACHED,
    Command,
    State,
    decode_statusword,
)
from hilbench.cia402.units import RPM, DriveUnits
from hilbench.errors import UnusableInputError

_ENABLED: Final = Command.ENABLE_OPERATION.value
#: Controlword in profile position mode: new set-point, at once; in homing mode: begin.
_NEW_SET_POINT: Final = _ENABLED | 1 << 4 | 1 << 5
#: Reached, and no set-point waits to be acknowledged any more.
_REACHED: Final = STATUS_TARGET_REACHED | STATUS_MODE_12
_HOMING: Final = _ENABLED | 1 << 4
#: It is at standstill when it has moved less than this many position units between two reads.
_STANDSTILL_UNITS: Final = 2

#: Objects that each mode needs in addition to 6040h, 6041h and 6060h.
_NEEDED: Final = {
    OperationMode.PROFILE_POSITION: (objects.TARGET_POSITION, objects.POSITION_ACTUAL_VALUE),
    OperationMode.PROFILE_VELOCITY: (objects.TARGET_VELOCITY,),
    OperationMode.TORQUE: (objects.TARGET_TORQUE,),
    OperationMode.HOMING: (objects.HOMING_METHOD, objects.POSITION_ACTUAL_VALUE),
}


def mode_name(mode: OperationMode) -> str:
    """Readable name of a mode."""
    return "profile torque" if mode is OperationMode.TORQUE else mode.name.replace("_", " ").lower()


@dataclass(frozen=True)
class Limits:
    """Limits of a motion, SI, motor side; infinite where none is given. `speed_by`, `torque_by`: object or key."""

    position_rad: tuple[float, float] = (-inf, inf)
    speed_rad_s: float = inf
    torque_Nm: float = inf
    speed_by: str = ""
    torque_by: str = ""


class SetUpDrive:
    """A drive that is moved by hand or by a script; it is enabled by each motion, and stays so.

    `eds` is the name of its file, for messages; `without_units` why its units are not known; `allowed` the limits of a
    config. Raises UnusableInputError for missing objects and for motions beyond a limit, before anything moves;
    BenchFaultError when it fails or hangs on its way.
    """

    def __init__(self, drive: ManualDrive, eds: str, allowed: Limits = Limits(), *, without_units: str = "") -> None:
        self.drive = drive
        self._eds = eds
        self._allowed = allowed
        self.without_units = without_units

    # --- units and limits ---------------------------------------------------------------------------------------------

    def lacking(self, mode: OperationMode) -> list[str]:
        """Reasons, by object, for which a mode can't be used; empty when it can."""
        needed = (objects.MODES_OF_OPERATION, *_NEEDED[mode])
        own = self.drive.object
        missing = [f"{own(index):04X}h is not in {self._eds}" for index in needed if not self.drive.has(index)]
        if not missing and self.drive.has(objects.SUPPORTED_DRIVE_MODES):
            bits = self.drive.read(objects.SUPPORTED_DRIVE_MODES)
            if bits and not bits & mode.supported_bit:
                modes = own(objects.SUPPORTED_DRIVE_MODES)
                missing.append(f"{modes:X}h is {bits:X}h, without bit {int(mode) - 1}")
        return missing

    def needs(self, mode: OperationMode) -> DriveUnits:
        """Check that the mode can be used, and return the units. Raises UnusableInputError."""
        missing = self.lacking(mode)
        if missing:
            raise UnusableInputError(self.drive.name, f"{', '.join(missing)}: {mode_name(mode)} can't be used")
        if self.drive.units is None:
            raise UnusableInputError(self.drive.name, self.without_units)
        return self.drive.units

    def limits(self) -> Limits:
        """Limits by the drive's own objects and the config, whichever is narrower."""
        units, allowed = self.drive.units, self._allowed
        if units is None:
            return allowed
        speeds = [(allowed.speed_rad_s, allowed.speed_by)]
        for index, factor in ((objects.MAX_PROFILE_VELOCITY, units.velocity_rad_s), (objects.MAX_MOTOR_SPEED, RPM)):
            if self.drive.has(index) and (value := self.drive.read(index)):
                speeds.append((value * factor, f"{self.drive.object(index):04X}h"))
        torques = [(allowed.torque_Nm, allowed.torque_by)]
        if self.drive.has(objects.MAX_TORQUE) and not isnan(units.torque_Nm):
            value = self.drive.read(objects.MAX_TORQUE)
            torques.append((value * units.torque_Nm or inf, f"{self.drive.object(objects.MAX_TORQUE):04X}h"))
        speed, torque = min(speeds), min(torques)
        return Limits(self._position_limits(units), speed[0], torque[0], speed[1], torque[1])

    def _position_limits(self, units: DriveUnits) -> tuple[float, float]:
        index = objects.SOFTWARE_POSITION_LIMIT
        if not self.drive.has(index, 1) or not self.drive.has(index, 2):
            return -inf, inf
        low, high = (self.drive.read(index, sub) for sub in (1, 2))
        return (low * units.position_rad, high * units.position_rad) if low < high else (-inf, inf)

    def _check_speed(self, speed_rad_s: float) -> None:
        limits = self.limits()
        if abs(speed_rad_s) > limits.speed_rad_s:
            raise UnusableInputError(
                self.drive.name,
                f"{abs(speed_rad_s):g} rad/s, expected at most {limits.speed_rad_s:g} rad/s ({limits.speed_by})",
            )

    # --- motions ------------------------------------------------------------------------------------------------------

    def move(self, position_rad: float, speed_rad_s: float, *, relative: bool = False) -> None:
        """Move to a position, in profile position mode with the drive's ramps; returns when it is reached."""
        units = self.needs(OperationMode.PROFILE_POSITION)
        self._check_speed(speed_rad_s)
        here = self.drive.read(objects.POSITION_ACTUAL_VALUE)
        target = round(position_rad / units.position_rad) + (here if relative else 0)
        self._check_position(target * units.position_rad)
        with self._written(objects.PROFILE_VELOCITY, max(1, round(speed_rad_s / units.velocity_rad_s))):
            self.drive.enable(OperationMode.PROFILE_POSITION)
            self.drive.write(objects.TARGET_POSITION, target)
            self.drive.write(objects.CONTROLWORD, _ENABLED)
            self.drive.write(objects.CONTROLWORD, _NEW_SET_POINT)
            self._until(lambda word: bool(word & STATUS_MODE_12), "to acknowledge the set-point (statusword bit 12)")
            self.drive.write(objects.CONTROLWORD, _ENABLED)
            reached = f"to reach {target * units.position_rad:.5g} rad"
            self._until(lambda word: word & _REACHED == STATUS_TARGET_REACHED, reached, moving=True)

    def _check_position(self, target_rad: float) -> None:
        low, high = self.limits().position_rad
        if not low <= target_rad <= high:
            raise UnusableInputError(
                self.drive.name,
                f"{target_rad:.5g} rad, expected {low:.5g} to {high:.5g} rad "
                f"({self.drive.object(objects.SOFTWARE_POSITION_LIMIT):X}h)",
            )

    def home(self, method: int | None = None) -> int:
        """Home by a method of 6098h (None: the one that it has); returns the method used."""
        self.needs(OperationMode.HOMING)
        if method is not None:
            self.drive.write(objects.HOMING_METHOD, method)
        used = self.drive.read(objects.HOMING_METHOD)
        self.drive.enable(OperationMode.HOMING)
        self.drive.write(objects.CONTROLWORD, _ENABLED)
        self.drive.write(objects.CONTROLWORD, _HOMING)
        ended = self._until(
            lambda word: bool(word & STATUS_MODE_13 or (word & STATUS_MODE_12 and word & STATUS_TARGET_REACHED)),
            f"to end homing method {used}",
            moving=True,
        )
        if ended & STATUS_MODE_13:
            raise self.drive.fault(f"homing method {used} failed: statusword {ended:04X}h, bit 13")
        self.drive.write(objects.CONTROLWORD, _ENABLED)
        return used

    def turn(self, velocity_rad_s: float, duration_s: float) -> None:
        """Turn at a velocity in profile velocity mode; after that time (inf: never) bring it to rest."""
        self.needs(OperationMode.PROFILE_VELOCITY)
        self._check_speed(velocity_rad_s)
        self.drive.enable(OperationMode.PROFILE_VELOCITY)
        self.drive.turn(velocity_rad_s)
        self._hold(duration_s, inf)
        self.drive.stop()

    def push(self, torque_Nm: float, duration_s: float, speed_limit_rad_s: float) -> None:
        """Apply a torque in profile torque mode; BenchFaultError when the motor gets faster than the limit."""
        units = self.needs(OperationMode.TORQUE)
        if isnan(units.torque_Nm):
            raise UnusableInputError(self.drive.name, "6076h is absent or 0, expected it or the unit 'rated_torque_Nm'")
        limits = self.limits()
        if abs(torque_Nm) > limits.torque_Nm:
            most = f"{limits.torque_Nm:g} N·m ({limits.torque_by})"
            raise UnusableInputError(self.drive.name, f"{abs(torque_Nm):g} N·m, expected at most {most}")
        if not self.drive.has(objects.VELOCITY_ACTUAL_VALUE):
            velocity = self.drive.object(objects.VELOCITY_ACTUAL_VALUE)
            raise UnusableInputError(
                self.drive.name,
                f"{velocity:X}h is not in {self._eds}: nobody would see how fast the motor gets, expected it",
            )
        self.drive.enable(OperationMode.TORQUE)
        self.drive.write(objects.TARGET_TORQUE, round(torque_Nm / units.torque_Nm))

        try:
            self._hold(duration_s, min(speed_limit_rad_s, limits.speed_rad_s))
        finally:
            self.drive.write(objects.TARGET_TORQUE, 0)
            self._slow_down()

    def _slow_down(self) -> None:
        """A motor without torque runs on: it is brought to rest by profile velocity, where the drive has that."""
        enabled = decode_statusword(self.drive.read(objects.STATUSWORD)) is State.OPERATION_ENABLED
        if enabled and not self.lacking(OperationMode.PROFILE_VELOCITY):
            self.drive.enable(OperationMode.PROFILE_VELOCITY)
            self.drive.stop()

    def _hold(self, duration_s: float, speed_limit_rad_s: float) -> None:
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self.drive.enabled_statusword()
            velocity = self.drive.status().velocity_rad_s if speed_limit_rad_s < inf else None
            if velocity is not None and abs(velocity) > speed_limit_rad_s:
                raise self.drive.fault(f"turns with {velocity:.4g} rad/s, the limit is {speed_limit_rad_s:g} rad/s")
            self.drive.pause()

    # --- waiting ------------------------------------------------------------------------------------------------------

    def _until(self, reached: Callable[[int], bool], what: str, *, moving: bool = False) -> int:
        """The statusword with which it is so. A time-out is only for a drive that does not move."""
        drive = self.drive
        deadline_s, place = time.monotonic() + drive.time_out_s, self._place()
        while not reached(word := drive.enabled_statusword()):
            if moving and abs((now := self._place()) - place) > _STANDSTILL_UNITS:
                deadline_s, place = time.monotonic() + drive.time_out_s, now
            if time.monotonic() > deadline_s:
                raise drive.fault(f"stood still for {drive.time_out_s:g} s, expected {what}; statusword {word:04X}h")
            drive.pause()
        return word

    def _place(self) -> int:
        index = objects.POSITION_ACTUAL_VALUE
        return self.drive.read(index) if self.drive.has(index) else 0

    @contextmanager
    def _written(self, index: int, value: int) -> Iterator[None]:
        """An object with another value meanwhile, if the drive has it."""
        if not self.drive.has(index):
            yield
            return
        before = self.drive.read(index)
        self.drive.write(index, value)
        try:
            yield
        finally:
            self.drive.write(index, before)


def usable(drive: SetUpDrive) -> dict[OperationMode, Sequence[str]]:
    """Each mode for set-up work, and what the drive lacks of it."""
    return {mode: drive.lacking(mode) for mode in _NEEDED}
