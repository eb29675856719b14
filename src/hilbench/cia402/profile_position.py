"""Mode 1, profile position: set-points by handshake, each a motion of constant accelerations (IEC 61800-7-201)."""

from __future__ import annotations

from math import inf
from typing import Final, NamedTuple

from hilbench.cia402.firmware import Firmware
from hilbench.cia402.mode import DebouncedCondition, Mode
from hilbench.cia402.state_machine import STATUS_MODE_12, STATUS_MODE_13, STATUS_TARGET_REACHED
from hilbench.cia402.trajectory import ProfileLimits, Trapezoid
from hilbench.plant.motor_port import MotorMode

# Controlword bits of this mode.
NEW_SET_POINT: Final = 1 << 4
CHANGE_IMMEDIATELY: Final = 1 << 5
RELATIVE: Final = 1 << 6
CHANGE_ON_SET_POINT: Final = 1 << 9

#: Of a drive without a ramp (6083h, 6084h = 0).
_AT_ONCE_RAD_S2: Final = 1e9
#: Of a motion that is not to move (6081h = 0): its target is never reached.
_NO_SPEED_RAD_S: Final = 1e-12


class _SetPoint(NamedTuple):
    target_rad: float
    limits: ProfileLimits
    #: Speed at the target, kept after it.
    end_velocity_rad_s: float
    #: It is passed with the speed of its motion, not stopped at, when another one follows.
    passes_on: bool


class ProfilePosition(Mode):
    """Each rising edge of bit 4 gives a set-point: 607Ah with 6081h, 6083h and 6084h as they are then.

    With bit 5 it is taken at once; else it waits until the one before it is reached (one can wait). Bit 12 of the
    statusword acknowledges it, and falls when bit 4 has fallen and there is room for another. With bit 9 the one before
    is passed without a stop. Profiles are trapezoidal (6086h = 0). A target is reached with the end velocity
    (6082h) where the distance suffices, else at rest; the motor keeps that velocity, to the limits of 607Dh at most.
    """

    motor_mode = MotorMode.POSITION
    follows_position = True

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._acknowledged = False
        self._asked = False  #: bit 4 as it was last
        self._current: _SetPoint | None = None
        self._waiting: _SetPoint | None = None
        self._profile: Trapezoid | None = None
        self._time_s = 0.0
        self._hold_rad: float | None = None
        self._in_window = DebouncedCondition()

    def enter(self) -> None:
        """Stay where the motor is; set-points of before are forgotten."""
        self._acknowledged = False
        self._current = self._waiting = self._profile = None
        self._hold_rad = None
        self._in_window = DebouncedCondition()

    def resume(self) -> None:
        """Continue to the set-point that the halt has interrupted."""
        if self._current is None:
            self.enter()
        else:
            self._profile = self._hold_rad = None
            self._go(self._current)

    def follow_controlword(self, controlword: int, previous: int) -> None:
        """The handshake of a new set-point."""
        asked = bool(controlword & NEW_SET_POINT)
        if asked and not previous & NEW_SET_POINT:
            self._take(controlword)
        self._asked = asked
        if not asked and self._waiting is None:
            self._acknowledged = False

    def _take(self, controlword: int) -> None:
        if self._waiting is not None and not controlword & CHANGE_IMMEDIATELY:
            return  # there is no room: bit 12 is still set
        new = self._set_point(controlword)
        self._acknowledged = True
        if controlword & CHANGE_IMMEDIATELY or self._arrived:
            self._waiting = None
            self._go(new)
            return
        self._waiting = new
        if new.passes_on and self._current is not None:
            self._go(self._current, through=True)

    def _set_point(self, controlword: int) -> _SetPoint:
        firmware = self._firmware
        if firmware.stale:  # what has come with the controlword, or just before it, counts
            firmware.refresh()
        asked = int(firmware.target_position.value)
        if controlword & RELATIVE:
            last = self._waiting or self._current
            base_rad = self._here_rad if last is None else last.target_rad
            target_rad = base_rad + asked * firmware.units.position_rad
        else:
            target_rad = firmware.angle_rad(asked)
        limits = ProfileLimits(
            min(firmware.profile_velocity_rad_s, firmware.velocity_limit_rad_s) or _NO_SPEED_RAD_S,
            firmware.acceleration_rad_s2 or _AT_ONCE_RAD_S2,
            firmware.deceleration_rad_s2 or _AT_ONCE_RAD_S2,
        )
        end = min(firmware.end_velocity_rad_s, limits.velocity)
        target = self._within_limits(target_rad)
        return _SetPoint(target, limits, end, bool(controlword & CHANGE_ON_SET_POINT))

    def _within_limits(self, position_rad: float) -> float:
        """Clip a position to 607Dh, which bounds the actual position."""
        firmware = self._firmware
        self.limited = False
        if firmware.software_limits is None:
            return position_rad
        unit_rad = firmware.units.position_rad
        low, high = ((limit - firmware.position_origin) * unit_rad for limit in firmware.software_limits)
        self.limited = not low <= position_rad <= high
        return max(low, min(high, position_rad))

    def _go(self, new: _SetPoint, *, through: bool = False) -> None:
        velocity = self._speed_rad_s
        end = new.limits.velocity if through else new.end_velocity_rad_s
        self._profile = Trapezoid(self._here_rad, velocity, new.target_rad, new.limits, end)
        self._current, self._time_s = new, 0.0
        self._in_window = DebouncedCondition()

    @property
    def _here_rad(self) -> float:
        """Present reference position, also after the target with its end velocity."""
        if self._profile is not None:
            position_rad, velocity_rad_s = self._profile.at(self._time_s)
            return position_rad + velocity_rad_s * max(self._time_s - self._profile.duration_s, 0.0)
        if self._hold_rad is None:
            port = self._firmware.port
            self._hold_rad = port.reference if port.mode is MotorMode.POSITION else port.position_rad
        return self._hold_rad

    @property
    def _speed_rad_s(self) -> float:
        if self._profile is not None:
            return self._profile.at(self._time_s)[1]
        measured = self._firmware.port.velocity_rad_s
        return measured if abs(measured) > self._firmware.standstill_rad_s else 0.0

    @property
    def _arrived(self) -> bool:
        return self._profile is None or self._time_s >= self._profile.duration_s

    def command(self) -> None:
        """The motion as far as it is at the end of this cycle."""
        dt_s = self._firmware.dt_s
        self._time_s += dt_s
        if self._arrived and self._waiting is not None:
            following, self._waiting = self._waiting, None
            self._acknowledged = self._asked
            self._go(following)
        port, wanted = self._firmware.port, self._here_rad
        if self._arrived and self._speed_rad_s:
            wanted = self._within_limits(wanted)
        before = port.reference if port.mode is MotorMode.POSITION else port.position_rad
        self._set(wanted, abs(wanted - before) / dt_s if dt_s > 0.0 else inf)

    def status(self, dt_s: float) -> int:
        """Bit 10: within 6067h of the set-point for 6068h; bit 12: acknowledged; bit 13: following error."""
        firmware = self._firmware
        bits = (STATUS_MODE_12 if self._acknowledged else 0) | (STATUS_MODE_13 if self.outside_window else 0)
        if not self._arrived or self._waiting is not None:
            self._in_window = DebouncedCondition()
            return bits
        left = abs(self._here_rad - firmware.port.position_rad) / firmware.units.position_rad
        reached = self._in_window.update(left <= firmware.position_window, dt_s, firmware.position_window_time_s)
        return bits | (STATUS_TARGET_REACHED if reached else 0)
