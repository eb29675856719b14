"""Interface of a drive's firmware to its motor: set points one way, measured feedback the other; SI, motor side.

The simulated drive (CiA-402 logic) writes the first group once per cycle or tick; the plant (the driven mechanics)
reads it, advances, and writes the second group. Neither depends on the other.

Bumpless transfer: when `mode` changes, the loop starts its reference at the present value of the new mode's controlled
quantity and moves it from there to the set point. A ramp ends on its set point exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import inf

#: Values of a motor's `feedback` in a vector, and the places of its torque and of its torque-limited flag (1: limited).
FEEDBACK_SIZE, TORQUE, LIMITED = 5, 2, 4


class MotorMode(IntEnum):
    """Mode of the drive's sampled control loop: meaning of the set point."""

    OFF = 0  #: power stage off: no torque, the shaft is free
    TORQUE = 1  #: set point is a torque in N·m
    VELOCITY = 2  #: set point is a velocity in rad/s
    POSITION = 3  #: set point is a position in rad


@dataclass(slots=True)
class MotorPort:
    """Interface between a drive's firmware and its motor."""

    # Written by the firmware.
    mode: MotorMode = MotorMode.OFF
    setpoint: float = 0.0  #: N·m, rad/s or rad, by `mode`
    slope: float = (
        inf  #: the control loop's reference moves towards the set point at most so fast (unit of setpoint / s)
    )
    torque_limit_Nm: float = inf

    # Written by the plant, as measured by the drive's sensors.
    reference: float = 0.0  #: present (ramped) reference (unit of setpoint)
    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_Nm: float = 0.0
    torque_limited: bool = False  #: the torque limit was reached since the last advance

    @property
    def feedback(self) -> tuple[float, float, float, float, bool]:
        """What the plant has written: position, velocity, torque, reference, whether the torque was limited."""
        return self.position_rad, self.velocity_rad_s, self.torque_Nm, self.reference, self.torque_limited

    @feedback.setter
    def feedback(self, shown: Sequence[float]) -> None:
        self.position_rad, self.velocity_rad_s, self.torque_Nm, self.reference, limited = shown
        self.torque_limited = limited != 0.0
