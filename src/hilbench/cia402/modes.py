"""Modes of operation of the simulated drive (6060h): set points to the motor, and statusword bits 10, 12, 13."""

from __future__ import annotations

from math import inf
from typing import ClassVar, Final

from hilbench.cia402.firmware import Firmware
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import STATUS_MODE_12, STATUS_MODE_13, STATUS_TARGET_REACHED
from hilbench.cia402.units import wrap_int32
from hilbench.plant.motor_port import MotorMode

HOMING_START: Final = 1 << 4  #: controlword bit 4 in homing mode


class Mode:
    """No mode chosen (6060h = 0): the motor is energized and without torque. Base of the modes."""

    motor_mode: ClassVar[MotorMode] = MotorMode.TORQUE

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        #: The set point was cut by a limit (statusword bit 11).
        self.limited = False

    def enter(self) -> None:
        """The mode begins to act: operation was enabled, or another mode left."""

    def command(self) -> None:
        """Set points of this cycle, from the target objects."""
        self._set(0.0)

    def follow_controlword(self, controlword: int, previous: int) -> None:
        """Mode-specific bits of a new controlword, in OPERATION ENABLED."""

    def status(self, dt_s: float) -> int:
        """Statusword bits 10, 12 and 13 after `dt_s` more seconds in OPERATION ENABLED, not halted."""
        return 0

    def _set(self, setpoint: float, slope: float = inf) -> None:
        port = self._firmware.port
        port.mode = self.motor_mode
        port.setpoint = setpoint
        port.slope = slope

    def _limit(self, setpoint: float, limit: float) -> float:
        self.limited = not -limit <= setpoint <= limit
        return max(-limit, min(limit, setpoint)) if self.limited else setpoint


class DebouncedCondition:
    """A condition that counts once it has held for a time (6067h-style windows)."""

    def __init__(self) -> None:
        self._held_s = 0.0

    def update(self, holds: bool, dt_s: float, time_s: float) -> bool:
        """Whether the condition has now held for `time_s` (times are compared to a microsecond)."""
        self._held_s = self._held_s + dt_s if holds else 0.0
        return holds and self._held_s + 1e-6 >= time_s


class ProfileVelocity(Mode):
    """Mode 3: ramps to 60FFh with 6083h and 6084h; bit 10 target reached (606Dh, 606Eh), bit 12 standstill (606Fh)."""

    motor_mode = MotorMode.VELOCITY

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._reached = DebouncedCondition()
        self._standstill = DebouncedCondition()
        self._target_rad_s = 0.0

    def enter(self) -> None:
        """Windows start anew."""
        self._reached = DebouncedCondition()
        self._standstill = DebouncedCondition()

    def command(self) -> None:
        """Ramp: deceleration while the speed is to fall, acceleration while it is to rise."""
        firmware, port = self._firmware, self._firmware.port
        target = int(firmware.target_velocity.value) * firmware.units.velocity_rad_s
        self._target_rad_s = target = self._limit(target, firmware.velocity_limit_rad_s)
        reference = port.reference if port.mode is MotorMode.VELOCITY else port.velocity_rad_s
        slower = target * reference < 0.0 or abs(target) < abs(reference)
        self._set(target, firmware.deceleration_rad_s2 if slower else firmware.acceleration_rad_s2)

    def status(self, dt_s: float) -> int:
        """Bit 10: within 606Dh of the target for 606Eh; bit 12: below 606Fh for 6070h."""
        firmware = self._firmware
        velocity = firmware.port.velocity_rad_s
        near = abs(velocity - self._target_rad_s) <= firmware.velocity_window_rad_s
        slow = abs(velocity) <= firmware.standstill_rad_s
        bits = 0
        if self._reached.update(near, dt_s, firmware.velocity_window_time_s):
            bits |= STATUS_TARGET_REACHED
        if self._standstill.update(slow, dt_s, firmware.standstill_time_s):
            bits |= STATUS_MODE_12
        return bits


class ProfileTorque(Mode):
    """Mode 4: ramps to 6071h with 6087h; bit 10 when the ramp has arrived."""

    def command(self) -> None:
        """The target torque, by the torque slope."""
        firmware = self._firmware
        target = int(firmware.target_torque.value) * firmware.units.torque_Nm
        self._set(self._limit(target, firmware.torque_limit_Nm), firmware.torque_slope_Nm_s)

    def status(self, dt_s: float) -> int:
        """Bit 10: the demand has reached the target."""
        port = self._firmware.port
        left_Nm = abs(port.setpoint - port.reference)
        return STATUS_TARGET_REACHED if left_Nm < self._firmware.units.torque_Nm else 0


class Homing(Mode):
    """Mode 6 with methods 35 and 37: the present position becomes 607Ch, at rest and without motion."""

    motor_mode = MotorMode.VELOCITY

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._attained = False
        self._error = False

    def command(self) -> None:
        """Hold still."""
        self._set(0.0, self._firmware.deceleration_rad_s2)

    def follow_controlword(self, controlword: int, previous: int) -> None:
        """Home on the rising edge of bit 4; a homing of a moving motor ends in the homing error."""
        if controlword & ~previous & HOMING_START:
            firmware = self._firmware
            self._error = abs(firmware.port.velocity_rad_s) > firmware.standstill_rad_s
            self._attained = not self._error
            if self._attained:
                firmware.set_home(int(firmware.home_offset.value))

    def status(self, dt_s: float) -> int:
        """Not started 10; attained 10 and 12; error 13, with 10 once the motor is at rest."""
        if self._error:
            moving = abs(self._firmware.port.velocity_rad_s) > self._firmware.standstill_rad_s
            return STATUS_MODE_13 | (0 if moving else STATUS_TARGET_REACHED)
        return STATUS_TARGET_REACHED | (STATUS_MODE_12 if self._attained else 0)


class CyclicSynchronousPosition(Mode):
    """Mode 8: follows 607Ah, interpolated over 60C2h; bit 13 following error.

    Targets are 32-bit counts that wrap: the motor goes the short way from where it is.
    """

    motor_mode = MotorMode.POSITION

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        #: The following error is outside its window 6065h.
        self.outside_window = False
        self._target: int | None = None
        self._approach_rad_s = inf

    def enter(self) -> None:
        """The first target is a new one."""
        self._target = None

    def command(self) -> None:
        """The target, approached so that it is reached when the interpolation period after it was given is over."""
        firmware = self._firmware
        here, target = firmware.encoder_count, int(firmware.target_position.value)
        distance = wrap_int32(target - here - firmware.position_origin)
        target_rad = (here + distance) * firmware.units.position_rad
        if target != self._target:
            self._target = target
            self._approach_rad_s = self._approach(target_rad)
        self._set(target_rad, self._limit(self._approach_rad_s, firmware.velocity_limit_rad_s))

    def _approach(self, target_rad: float) -> float:
        """Speed (rad/s) that bridges the distance to a new target in the interpolation period."""
        port, period_s = self._firmware.port, self._firmware.interpolation_period_s
        reference_rad = port.reference if port.mode is MotorMode.POSITION else port.position_rad
        return abs(target_rad - reference_rad) / period_s if period_s > 0.0 else inf

    def status(self, dt_s: float) -> int:
        """Bit 12: the drive follows; bit 13: the following error is outside its window."""
        return STATUS_MODE_12 | (STATUS_MODE_13 if self.outside_window else 0)


class CyclicSynchronousVelocity(Mode):
    """Mode 9: follows 60FFh + 60B1h."""

    motor_mode = MotorMode.VELOCITY

    def command(self) -> None:
        """The target velocity, limited by 607Fh and 6080h."""
        firmware = self._firmware
        target = int(firmware.target_velocity.value) + int(firmware.velocity_offset.value)
        self._set(self._limit(target * firmware.units.velocity_rad_s, firmware.velocity_limit_rad_s))

    def status(self, dt_s: float) -> int:
        """Bit 12: the drive follows."""
        return STATUS_MODE_12


class CyclicSynchronousTorque(Mode):
    """Mode 10: follows 6071h + 60B2h."""

    def command(self) -> None:
        """The target torque, limited by 6072h."""
        firmware = self._firmware
        target = int(firmware.target_torque.value) + int(firmware.torque_offset.value)
        self._set(self._limit(target * firmware.units.torque_Nm, firmware.torque_limit_Nm))

    def status(self, dt_s: float) -> int:
        """Bit 12: the drive follows."""
        return STATUS_MODE_12


MODES: Final = {
    OperationMode.NONE: Mode,
    OperationMode.PROFILE_VELOCITY: ProfileVelocity,
    OperationMode.TORQUE: ProfileTorque,
    OperationMode.HOMING: Homing,
    OperationMode.CYCLIC_SYNCHRONOUS_POSITION: CyclicSynchronousPosition,
    OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY: CyclicSynchronousVelocity,
    OperationMode.CYCLIC_SYNCHRONOUS_TORQUE: CyclicSynchronousTorque,
}
