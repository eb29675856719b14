"""Base of the modes of operation of the simulated drive (6060h)."""

from __future__ import annotations

from math import inf
from typing import ClassVar

from hilbench.cia402.firmware import Firmware
from hilbench.plant.motor_port import MotorMode


class Mode:
    """No mode chosen (6060h = 0): the motor is energized and without torque. Base of the modes."""

    motor_mode: ClassVar[MotorMode] = MotorMode.TORQUE
    #: The following error is supervised (6065h, 6066h).
    follows_position: ClassVar[bool] = False

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        #: The set point was cut by a limit (statusword bit 11).
        self.limited = False
        #: The following error is outside its window 6065h.
        self.outside_window = False

    def enter(self) -> None:
        """The mode begins to act: operation was enabled, or another mode left."""

    def resume(self) -> None:
        """Resume the mode after a halt."""
        self.enter()

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
        """True if the condition has now held for `time_s` (times are compared to a microsecond)."""
        self._held_s = self._held_s + dt_s if holds else 0.0
        return holds and self._held_s + 1e-6 >= time_s
