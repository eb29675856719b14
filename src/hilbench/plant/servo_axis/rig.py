"""Simulated hardware of a servo axis: the real shaft, the load motor on it, and their sensors.

Emulation by the load motor (`hilbench.plant.servo_axis.emulation`) is not included.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np

from hilbench.plant.motor_port import MotorPort
from hilbench.plant.sensors import SensorNoise, Sensors, show
from hilbench.plant.servo_axis.parameters import ServoRigParameters
from hilbench.plant.servo_axis.shaft import Shaft


class ServoRig(Shaft):
    """Rig as a `Plant` with two motors on one shaft; ports in the order axis, load motor.

    A positive torque of either turns the shaft forward. The drives' loops act on the true motion; noise and resolution
    are in the ports' feedback. Equal parameters, seed and set points give equal feedback, bit for bit. Raises
    ValueError unless there are two ports and the axis has drives.
    """

    def __init__(
        self, parameters: ServoRigParameters, ports: Sequence[MotorPort], seed: int = 0, *, substeps: int = 1
    ) -> None:
        if len(ports) != 2 or parameters.axis.drives is None:
            raise ValueError(f"{len(ports)} ports, expected those of the axis and the load motor, and drives")
        self._noise: SensorNoise = SensorNoise(np.random.SeedSequence(seed).spawn(len(ports)))
        self._sensors = [Sensors(kind) for kind in (parameters.sensors, parameters.load_sensors)]
        self._sensor_figures = np.array([each.figures for each in self._sensors]).reshape(-1)
        super().__init__(parameters.axis, parameters.load_motor, ports, substeps)

    def _observe(self) -> None:
        super()._observe()
        show(self._ports, self._sensors, self._noise)

    def _memory(self) -> object:
        shown = [(port.position_rad, port.velocity_rad_s, port.torque_Nm) for port in self._ports]
        return super()._memory(), deepcopy(self._noise), shown

    def _restore(self, memory: object) -> None:
        match memory:
            case (state, SensorNoise() as noise, list() as shown):
                super()._restore(state)
            case _:
                raise ValueError("a state of another machine, expected one of an equal simulated servo axis")
        # Restore the sensors' readings: observing again would draw other noise.
        self._noise = deepcopy(noise)
        for port, (position, velocity, torque) in zip(self._ports, shown, strict=True):
            port.position_rad, port.velocity_rad_s, port.torque_Nm = position, velocity, torque
