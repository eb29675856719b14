"""Mode 1, profile position: set-points by handshake, each a motion of constant accelerations (IEC 61800-7-201)."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, inf, sqrt
from typing import Final, NamedTuple

from hilbench.cia402.firmware import Firmware
from hilbench.cia402.mode import DebouncedCondition, Mode
from hilbench.cia402.state_machine import STATUS_MODE_12, STATUS_MODE_13, STATUS_TARGET_REACHED
from hilbench.plant.motor_port import MotorMode


@dataclass(frozen=True)
class ProfileLimits:
    """Limits of a motion; all above 0, in one unit of length (rad) and seconds."""

    velocity: float
    acceleration: float
    deceleration: float


@dataclass(frozen=True)
class _Phase:
    """A stretch of constant acceleration, from its start."""

    begin_s: float
    position: float
    velocity: float
    acceleration: float


class Trapezoid:
    """The fastest motion with constant accelerations from `position` and `velocity` to `target`.

    It arrives there with the speed `end_velocity` in its direction of travel (0 or more), or at rest where it can't.
    An axis that is too fast to stop before the target goes back to it; one that is faster than allowed slows down.
    """

    def __init__(
        self, position: float, velocity: float, target: float, limits: ProfileLimits, end_velocity: float = 0.0
    ) -> None:
        self.target = target
        self._phases: list[_Phase] = []
        self._time_s, self._position, self._velocity = 0.0, position, velocity
        stops_at = position + velocity * abs(velocity) / (2.0 * limits.deceleration)
        ahead = target - position
        passes = end_velocity > 0.0 and _passes(ahead, velocity, end_velocity, limits)
        self._sign = copysign(1.0, ahead if passes else target - stops_at)
        self._plan(limits, min(end_velocity, limits.velocity) if passes else 0.0)
        #: When the target is reached (s after the start).
        self.duration_s = self._time_s
        self._end_velocity = self._velocity

    def at(self, time_s: float) -> tuple[float, float]:
        """Position and velocity `time_s` after the start; after the end, at the target."""
        if time_s >= self.duration_s:
            return self.target, self._end_velocity
        phase = next((each for each in reversed(self._phases) if each.begin_s <= time_s), self._phases[0])
        passed_s = time_s - phase.begin_s
        velocity = phase.velocity + phase.acceleration * passed_s
        return phase.position + 0.5 * (phase.velocity + velocity) * passed_s, velocity

    def _plan(self, limits: ProfileLimits, end: float) -> None:
        if self._velocity * self._sign < 0.0:
            self._until(0.0, limits.deceleration)
        if self._velocity * self._sign > limits.velocity:
            self._until(limits.velocity, limits.deceleration)
        speed, distance = self._velocity * self._sign, (self.target - self._position) * self._sign
        up, down = limits.acceleration, limits.deceleration
        peak_squared = (2.0 * up * down * distance + down * speed**2 + up * end**2) / (up + down)
        peak = min(max(sqrt(max(peak_squared, 0.0)), speed), limits.velocity)
        self._until(peak, up)
        braking = max(peak**2 - end**2, 0.0) / (2.0 * down)
        cruise = (self.target - self._position) * self._sign - braking
        if cruise > 0.0 and peak > 0.0:
            self._add(cruise / peak, 0.0)
        self._until(min(end, peak), down)

    def _until(self, speed: float, rate: float) -> None:
        """Change the speed in the direction of travel to `speed`, `rate` per second."""
        change = speed * self._sign - self._velocity
        if change:
            self._add(abs(change) / rate, copysign(rate, change))
            self._velocity = speed * self._sign  # without what rounding leaves

    def _add(self, duration_s: float, acceleration: float) -> None:
        self._phases.append(_Phase(self._time_s, self._position, self._velocity, acceleration))
        before = self._velocity
        self._velocity += acceleration * duration_s
        self._position += 0.5 * (before + self._velocity) * duration_s
        self._time_s += duration_s


def _passes(ahead: float, velocity: float, end: float, limits: ProfileLimits) -> bool:
    """True if the target can be passed with the speed `end` without reversing."""
    speed = velocity if ahead > 0.0 else -velocity
    reach = abs(ahead)
    fast_enough = max(speed, 0.0) ** 2 + 2.0 * limits.acceleration * reach >= end**2
    return speed >= 0.0 and fast_enough and speed**2 - end**2 <= 2.0 * limits.deceleration * reach


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
