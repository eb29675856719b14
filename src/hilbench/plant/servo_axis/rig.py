"""The simulated hardware of a servo axis: the shaft that there is, the load motor on it, and their sensors.

What the load motor imitates (`hilbench.plant.servo_axis.imitation`) is not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np

from hilbench.block import Block
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.sensors import SensorNoise, SensorParameters, Sensors, show
from hilbench.plant.servo_axis.effects import ShaftEffect
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.plant.servo_axis.shaft import Shaft


class ServoRigParameters(Block):
    """The simulated hardware. `matching` fills it from a model."""

    axis: ServoAxisParameters  #: as it is really built, without the load motor's rotor
    load_motor: LoadMotorParameters = LoadMotorParameters()
    sensors: SensorParameters = SensorParameters()
    load_sensors: SensorParameters = SensorParameters()

    @property
    def inertia_kg_m2(self) -> float:
        """All that really turns, the load motor's rotor included; without effects."""
        return self.axis.inertia_kg_m2 + self.load_motor.inertia_kg_m2

    @classmethod
    def matching(
        cls,
        model: ServoAxisParameters,
        shaft: ShaftParameters | None = None,
        load_motor: LoadMotorParameters | None = None,
        sensors: SensorParameters | None = None,
        effects: Sequence[ShaftEffect] = (),
    ) -> ServoRigParameters:
        """The stand on which a model's drive turns `shaft`; without one, the model's, so that nothing is imitated.

        The load motor's inertia is then taken off the shaft. Raises ValueError for a model without drives, or with less
        inertia than the load motor.
        """
        if model.drives is None:
            raise ValueError("the model has no drives, expected 'drives'")
        load = load_motor or LoadMotorParameters()
        if shaft is None:
            left = model.shaft.inertia_kg_m2 - load.inertia_kg_m2
            if left < 0.0:
                raise ValueError(
                    f"load motor of {load.inertia_kg_m2} kg·m², expected at most the shaft's "
                    f"{model.shaft.inertia_kg_m2:.6g} kg·m²"
                )
            shaft = model.shaft.model_copy(update={"inertia_kg_m2": left})
        return cls(
            axis=ServoAxisParameters(shaft=shaft, motor=model.motor, drives=model.drives, effects=tuple(effects)),
            load_motor=load,
            sensors=sensors or SensorParameters(),
            load_sensors=sensors or SensorParameters(),
        )


class ServoRig(Shaft):
    """A `Plant` with two motors on one shaft; ports in the order axis, load motor.

    A positive torque of either turns the shaft forward. The drives' loops act on the true motion; noise and resolution
    are in what the ports report. Equal parameters, seed and set points give equal feedback, bit for bit. Raises
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
        # What the sensors showed then, and will show from there on: to look once more would draw other noise.
        self._noise = deepcopy(noise)
        for port, (position, velocity, torque) in zip(self._ports, shown, strict=True):
            port.position_rad, port.velocity_rad_s, port.torque_Nm = position, velocity, torque
