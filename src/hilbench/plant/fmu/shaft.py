"""Servo axis whose mechanics are an FMU: for the twin, and as simulated hardware with load motor and sensors.

Per sample time of the drives their loops are run once, and the FMU is advanced by it with the mean of their torques.
Its motion is used unchanged, except for a constant offset of the position (`set_state`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from hilbench.plant.fmu import drives
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.fmu.effects import WithoutEffects
from hilbench.plant.fmu.model import FmuModel, FmuState
from hilbench.plant.interface import PlantState
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.axis import ServoAxis
from hilbench.plant.servo_axis.layout import PARAMETERS, Vector
from hilbench.plant.servo_axis.parameters import ServoRigParameters
from hilbench.plant.servo_axis.rig import ServoRig
from hilbench.plant.servo_axis.shaft import Shaft


class FmuMechanics(WithoutEffects, Shaft):
    """Base of both. Parameters that the FMU does not have are stored without effect."""

    _model: FmuModel

    def _open(self, parameters: FmuAxisParameters, report: Callable[[str], None]) -> None:
        found = parameters.variables()
        self._mapped = found.parameters
        sample_s = self._p.item(lay.P_SAMPLE_TIME_S)
        outputs = [found.position, found.speed]
        self._model = FmuModel(parameters, [found.torque], outputs, sample_s, report, mean=True)
        for name, variable in self._mapped.items():
            self._model.give(variable, self._p.item(PARAMETERS[name][1]))
        self._offset_rad = 0.0
        self._restart()

    def _restart(self) -> None:
        """Restart the FMU; the position is kept."""
        self._model.start()
        position, speed = self._model.values
        self._offset_rad = self._state.item(lay.S_X) - position
        self._state[lay.S_V] = speed

    def _go(self, samples: int) -> None:
        state, sample_s = self._state, self._p.item(lay.P_SAMPLE_TIME_S)
        state[lay.S_MEAN] = 0.0
        for _ in range(samples):
            torque = drives.sample(self._p, state, self._inputs)
            position, speed = self._model.advance([torque], sample_s)
            state[lay.S_X] = position + self._offset_rad + speed * self._model.behind_s
            state[lay.S_V] = speed
        state[lay.S_MEAN] /= samples

    def steps_in_modes(self, set_points: Vector, duration_s: float, shown: Vector) -> None:
        """None: the FMU's step is its own code."""

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on. Raises ValueError for an unknown name or an impossible value."""
        changed = value != self.parameter(name)
        super().set_parameter(name, value)
        if changed and name in self._mapped:
            self._model.put_with_next_step(self._mapped[name], value)

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of an equal axis, or transfer the states given by name.

        A position is set by an offset; the only possible speed is that of the FMU's start: other speeds are left to the
        drive, which reaches its set point within its loop's time.
        """
        super().set_state(state)
        if isinstance(state, PlantState):
            return
        if state.get("v1_rad_s") == 0.0:
            self._restart()
        else:
            position, speed = self._model.values
            self._offset_rad = self._state.item(lay.S_X) - position - speed * self._model.behind_s
            self._state[lay.S_V] = speed
        self._observe()

    def _memory(self) -> object:
        return super()._memory(), self._model.take_state(), self._offset_rad

    def _restore(self, memory: object) -> None:
        match memory:
            case (of_drives, FmuState() as kept, float() as offset_rad):
                super()._restore(of_drives)
                self._model.give_state(kept)
                self._offset_rad = offset_rad
            case _:
                raise ValueError("a state of another machine, expected one of this FMU")


class FmuAxis(FmuMechanics, ServoAxis):
    """Closed model: drive and FMU. Raises as `ServoAxis`, and BenchFaultError when the FMU fails."""

    def __init__(
        self,
        parameters: FmuAxisParameters,
        ports: Sequence[MotorPort] | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        ServoAxis.__init__(self, parameters, ports)
        self._open(parameters, report)


class FmuRig(FmuMechanics, ServoRig):
    """Simulated hardware: drive and load motor on the FMU, with sensors. Raises as `ServoRig`, and as `FmuAxis`."""

    def __init__(
        self,
        fmu: FmuAxisParameters,
        parameters: ServoRigParameters,
        ports: Sequence[MotorPort],
        seed: int = 0,
        report: Callable[[str], None] = print,
    ) -> None:
        ServoRig.__init__(self, parameters, ports, seed)
        self._open(fmu, report)
