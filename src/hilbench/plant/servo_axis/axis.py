"""Closed model of a servo axis: drive, motor and shaft, advanced in step with the bus; simulated by the twin."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.motor_port import MotorPort
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import Shaft


class ServoAxis(Shaft):
    """Closed model, a `Plant` with one motor. Raises ValueError for unfit ports, or a port on a model without
    drives."""

    def __init__(
        self, parameters: ServoAxisParameters, ports: Sequence[MotorPort] | None = None, *, substeps: int = 1
    ) -> None:
        if ports is not None and (parameters.drives is None or len(ports) != 1):
            raise ValueError(f"{len(ports)} ports, expected a model with drives and one port")
        self.parameters = parameters
        super().__init__(parameters, None, ports or (), substeps)
