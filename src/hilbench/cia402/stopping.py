"""Stops of a drive: the choices of the option codes 605Ah to 605Eh."""

from __future__ import annotations

from enum import Enum
from math import inf
from typing import Final

from hilbench.cia402.firmware import Firmware
from hilbench.cia402.state_machine import Transition
from hilbench.plant.motor_port import MotorMode


class StopKind(Enum):
    """Kinds of stop; the numbers are those that the option codes share."""

    COAST = 0  #: power stage off, the shaft is free
    SLOW_DOWN_RAMP = 1  #: 6084h
    QUICK_STOP_RAMP = 2  #: 6085h
    CURRENT_LIMIT = 3  #: as hard as the torque limit allows
    VOLTAGE_LIMIT = 4  #: the simulated drive's voltage is never the limit: as CURRENT_LIMIT


#: 605Ah: how to stop, and whether the drive stays in QUICK STOP ACTIVE: 0 to 4 switch off, 5 to 8 stay.
QUICK_STOP_OPTIONS: Final = {code: (StopKind(code if code <= 4 else code - 4), code >= 5) for code in range(9)}


class Stop:
    """The stop of a drive, while it is `active`.

    In the velocity and position modes the drive ramps its velocity down; in the torque modes it ramps its torque
    down by the torque slope 6087h, since a torque-controlled motor has no velocity of its own to hold.
    """

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._motor_mode = MotorMode.VELOCITY
        self._kind = StopKind.SLOW_DOWN_RAMP
        self.active = False
        #: The motor is at rest (velocity modes: below 606Fh), or without torque (torque modes).
        self.at_rest = False
        #: The transition that follows when the motor is at rest.
        self.then: Transition | None = None

    def begin(self, kind: StopKind, torque_mode: bool, then: Transition | None) -> None:
        """Start to stop (not by COAST: that is a power stage switched off)."""
        self._kind = kind
        self._motor_mode = MotorMode.TORQUE if torque_mode else MotorMode.VELOCITY
        self.active = True
        self.at_rest = False
        self.then = then

    def end(self) -> None:
        """End the stop: power is off, or the mode of operation acts again."""
        self.active = self.at_rest = False
        self.then = None

    def command(self) -> None:
        """Set points of this cycle."""
        port = self._firmware.port
        port.mode = self._motor_mode
        port.setpoint = 0.0
        port.slope = self._slope()

    def _slope(self) -> float:
        firmware, kind = self._firmware, self._kind
        if kind in (StopKind.CURRENT_LIMIT, StopKind.VOLTAGE_LIMIT):
            return inf
        if self._motor_mode is MotorMode.TORQUE:
            return firmware.torque_slope_Nm_s
        if kind is StopKind.QUICK_STOP_RAMP:
            return firmware.quick_stop_deceleration_rad_s2
        return firmware.deceleration_rad_s2

    def check_rest(self) -> bool:
        """Update and return `at_rest`, after the plant has advanced with this stop's set points."""
        port = self._firmware.port
        commanded = port.mode is self._motor_mode and port.setpoint == 0.0
        still = self._motor_mode is MotorMode.TORQUE or abs(port.velocity_rad_s) <= self._firmware.standstill_rad_s
        self.at_rest = commanded and port.reference == 0.0 and still
        return self.at_rest
