"""A simulated drive with all that it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hilbench.apps.devices.behaviour import Behaviour
from hilbench.canopen.device import Device
from hilbench.cia402.axis import AxisDevice
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.simulated import SimulatedDrive as Cia402Drive
from hilbench.cia402.simulated import supported_modes
from hilbench.cia402.units import DriveUnits
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.servo_axis.shaft import ServoRig


@dataclass(frozen=True)
class SimulatedNode:
    """One drive as it was made: a node, or one of its axes."""

    device: Device
    drive: Cia402Drive
    port: MotorPort
    rig: ServoRig
    units: DriveUnits
    behaviour: Behaviour
    #: What the EDS file does not tell, and was taken for granted; one line each.
    assumptions: Sequence[str]
    name: str
    axis: int = 1

    @property
    def modes(self) -> list[OperationMode]:
        """Modes of operation that it has."""
        supported = supported_modes(AxisDevice(self.device, self.axis))
        return [mode for mode in OperationMode if mode and supported & mode.supported_bit]
