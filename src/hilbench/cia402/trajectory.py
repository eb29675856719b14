"""Motion profile from a position and speed to rest at a target, within speed and accelerations."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, sqrt


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
        phase = self._phases[0]
        for later in self._phases[1:]:
            if later.begin_s > time_s:
                break
            phase = later
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
