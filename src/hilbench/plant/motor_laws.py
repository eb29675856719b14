"""Laws of a motor and its sensors common to every machine: small compiled functions.

Slots of an effect are (slots, parameters): of a wave over an angle amplitude, order, phase (rad). Angles and speeds are
the motor's, rad and rad/s.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Vector, compiled, inlined, noinline

Slots = NDArray[np.float64]

#: Steps of Newton's method from a measured angle to the true one; an error of 0.5 rad needs five.
_ANGLE_PASSES = 6


@inlined
def is_any(slots: Slots, strength: int) -> bool:
    """True if any slot of an effect is used; `strength`: column of its strength."""
    found = False
    for slot in range(len(slots)):
        found |= slots[slot, strength] != 0.0
    return found


@inlined
def wave_sum(slots: Slots, scale: float, angle: float, start: float) -> float:
    """Start + sum of A·sin(scale·n·angle + phi0), in the unit of start and A."""
    return _wave_sum(slots, scale, angle, start) if is_any(slots, 0) else start


@compiled
def _wave_sum(slots: Slots, scale: float, angle: float, start: float) -> float:
    noinline()
    total = start
    for slot in range(len(slots)):
        if slots[slot, 0] != 0.0:
            total += slots[slot, 0] * sin(scale * slots[slot, 1] * angle + slots[slot, 2])
    return total


@compiled
def measured_motion(amplitude_rad: float, phase_rad: float, angle_rad: float, rad_s: float) -> tuple[float, float]:
    """Angle and speed measured by an encoder with an error once per turn: phi + A·sin(phi + phi0)."""
    noinline()
    at = angle_rad + phase_rad
    return angle_rad + amplitude_rad * sin(at), rad_s * (1.0 + amplitude_rad * cos(at))


@compiled
def true_motion(
    amplitude_rad: float, phase_rad: float, angle_rad: float, rad_s: float, rad_s2: float
) -> tuple[float, float, float]:
    """True angle, speed and acceleration from measured ones: the inverse of `measured_motion`."""
    noinline()
    angle = angle_rad
    for _ in range(_ANGLE_PASSES):
        error = angle + amplitude_rad * sin(angle + phase_rad) - angle_rad
        angle -= error / (1.0 + amplitude_rad * cos(angle + phase_rad))
    slope = 1.0 + amplitude_rad * cos(angle + phase_rad)
    speed = rad_s / slope
    return angle, speed, (rad_s2 + amplitude_rad * sin(angle + phase_rad) * speed**2) / slope


@inlined
def past_torque_Nm(s: Vector, past: int, ring: int, count: int, samples: float) -> float:
    """Torque of so many `samples` ago, linear between them: that of sample k is at `past` + k % `ring` of `s`, and
    `count` is the newest."""
    whole = int(samples)
    newer = s[past + max(count - whole, 0) % ring]
    older = s[past + max(count - whole - 1, 0) % ring]
    return newer + (older - newer) * (samples - whole)


@inlined
def measured_direction(speed: float, width: float) -> float:
    """Sign of a measured speed, linear within ±`width` (same unit): -1 to 1."""
    return min(max(speed / width, -1.0), 1.0)


@inlined
def value_at(column: Vector, row: float) -> float:
    """Value of a column (N,) at a row from 0 to N - 1, linear between rows."""
    first = min(int(row), len(column) - 2)
    return column[first] + (row - first) * (column[first + 1] - column[first])
