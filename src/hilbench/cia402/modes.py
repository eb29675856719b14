"""The modes of operation of the simulated drive (6060h): set points to the motor, and statusword bits 10, 12, 13."""

from __future__ import annotations

from math import inf
from typing import Final

from hilbench.cia402.firmware import Firmware
from hilbench.cia402.homing import Homing
from hilbench.cia402.mode import DebouncedCondition, Mode
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.profile_position import ProfilePosition
from hilbench.cia402.state_machine import STATUS_MODE_12, STATUS_MODE_13, STATUS_TARGET_REACHED
from hilbench.cia402.units import RPM
from hilbench.plant.motor_port import MotorMode

#: Controlword bit 4 in interpolated position mode.
INTERPOLATION_ENABLED: Final = 1 << 4
#: Controlword bits 4 to 6 in velocity mode.
RAMP_ENABLED: Final = 1 << 4
RAMP_UNLOCKED: Final = 1 << 5
RAMP_USES_REFERENCE: Final = 1 << 6


class ProfileVelocity(Mode):
    """Mode 3: ramps to 60FFh with 6083h and 6084h; bit 10 target reached (606Dh, 606Eh), bit 12 standstill (606Fh)."""

    motor_mode = MotorMode.VELOCITY

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._reached = DebouncedCondition()
        self._standstill = DebouncedCondition()
        self._target_rad_s = 0.0

    def enter(self) -> None:
        """Reset the windows."""
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


class CyclicSynchronousPosition(Mode):
    """Mode 8: follows 607Ah, interpolated over 60C2h; bit 13 following error.

    Targets are 32-bit counts that wrap: the motor takes the shorter direction.
    """

    motor_mode = MotorMode.POSITION
    follows_position = True

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._target: int | None = None
        self._approach_rad_s = inf

    def enter(self) -> None:
        """The first target is a new one."""
        self._target = None

    def command(self) -> None:
        """The target, approached so that it is reached when the interpolation period after it was given is over."""
        firmware = self._firmware
        target = self._asked()
        target_rad = firmware.angle_rad(target)
        if target != self._target:
            self._target = target
            port, period_s = self._firmware.port, self._firmware.interpolation_period_s
            reference_rad = port.reference if port.mode is MotorMode.POSITION else port.position_rad
            # The speed that bridges the distance to the new target in the interpolation period.
            self._approach_rad_s = abs(target_rad - reference_rad) / period_s if period_s > 0.0 else inf
        self._set(target_rad, self._limit(self._approach_rad_s, firmware.velocity_limit_rad_s))

    def _asked(self) -> int:
        """The target of this cycle, in position units."""
        return int(self._firmware.target_position.value)

    def status(self, dt_s: float) -> int:
        """Bit 12: the drive follows; bit 13: the following error is outside its window."""
        return STATUS_MODE_12 | (STATUS_MODE_13 if self.outside_window else 0)


class InterpolatedPosition(CyclicSynchronousPosition):
    """Mode 7 with linear interpolation: follows 60C1h:1 while bit 4 of the controlword is set, else stays."""

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._active = False
        self._stays_at: int | None = None

    def enter(self) -> None:
        """Hold the position until the controlword starts a motion."""
        super().enter()
        self._active, self._stays_at = False, None

    def follow_controlword(self, controlword: int, previous: int) -> None:
        """Bit 4: interpolation is enabled."""
        active = bool(controlword & INTERPOLATION_ENABLED)
        if active is not self._active:
            self._active, self._stays_at = active, None

    def _asked(self) -> int:
        if self._active:
            return int(self._firmware.interpolated_target.value)
        if self._stays_at is None:
            self._stays_at = int(self._firmware.position_actual.value)
        return self._stays_at

    def status(self, dt_s: float) -> int:
        """Bit 10: the target is reached; bit 12: interpolation is active."""
        port = self._firmware.port
        reached = abs(port.setpoint - port.reference) < self._firmware.units.position_rad
        return (STATUS_TARGET_REACHED if reached else 0) | (STATUS_MODE_12 if self._active else 0)


class Velocity(Mode):
    """Mode 2 (vl): follows 6042h (rpm) by the ramps 6048h and 6049h, between the amounts of 6046h.

    Bits 4 to 6 of the controlword: without 6 the ramp's input is 0, without 5 its output stays, without 4 it goes to 0.
    """

    motor_mode = MotorMode.VELOCITY

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._bits = 0

    def command(self) -> None:
        """The ramp's input, or its output where it is locked."""
        firmware, port = self._firmware, self._firmware.port
        reference = port.reference if port.mode is MotorMode.VELOCITY else port.velocity_rad_s
        running = self._bits & RAMP_ENABLED and self._bits & RAMP_USES_REFERENCE
        target = self._amount(int(firmware.vl_target.value) * RPM) if running else 0.0
        if self._bits & RAMP_ENABLED and not self._bits & RAMP_UNLOCKED:
            target = reference
        slower = target * reference < 0.0 or abs(target) < abs(reference)
        self._set(target, firmware.vl_deceleration_rad_s2 if slower else firmware.vl_acceleration_rad_s2)
        firmware.vl_demand.value = round(reference / RPM)

    def _amount(self, target: float) -> float:
        slowest, fastest = self._firmware.vl_slowest_rad_s, self._firmware.vl_fastest_rad_s
        if target and abs(target) < slowest:
            self.limited = True
            return slowest if target > 0.0 else -slowest
        return self._limit(target, fastest)

    def follow_controlword(self, controlword: int, previous: int) -> None:
        """Bits 4, 5 and 6."""
        self._bits = controlword


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
    OperationMode.PROFILE_POSITION: ProfilePosition,
    OperationMode.VELOCITY: Velocity,
    OperationMode.PROFILE_VELOCITY: ProfileVelocity,
    OperationMode.TORQUE: ProfileTorque,
    OperationMode.HOMING: Homing,
    OperationMode.INTERPOLATED_POSITION: InterpolatedPosition,
    OperationMode.CYCLIC_SYNCHRONOUS_POSITION: CyclicSynchronousPosition,
    OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY: CyclicSynchronousVelocity,
    OperationMode.CYCLIC_SYNCHRONOUS_TORQUE: CyclicSynchronousTorque,
}
