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
from hilbench.plant.servo_axis.layout import PARAMETERS
from hilbench.plant.servo_axis.parameters import ServoRigParameters
from hilbench.plant.servo_axis.shaft import ServoAxis, ServoRig, Shaft


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
        self._put_motion(self._state.item(lay.S_X), speed)

    def _put_motion(self, position_rad: float, speed_rad_s: float) -> None:
        self._state[lay.S_X : lay.S_V_BEHIND + 1] = position_rad, speed_rad_s, position_rad, speed_rad_s

    def _advance(self, samples: int) -> None:
        means, sample_s = self._layout.motor_states(self._state).mean_Nm, self._p.item(lay.P_SAMPLE_TIME_S)
        means[:] = 0.0
        for _ in range(samples):
            torque = drives.sample(self._p, self._state, self._inputs)
            position, speed = self._model.advance([torque], sample_s)
            self._put_motion(position + self._offset_rad + speed * self._model.behind_s, speed)
        means /= samples

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
        if isinstance(state, PlantState):
            match state.memory:
                case (of_drives, FmuState() as kept, float() as offset_rad):
                    super().set_state(PlantState(state.values, of_drives))
                    self._offset_rad = offset_rad
                    self._model.give_state(kept)
                case _:
                    raise ValueError("a state of another machine, expected one of this FMU")
            return
        super().set_state(state)
        if state.get("v1_rad_s") == 0.0:
            self._restart()
        else:
            position, speed = self._model.values
            self._offset_rad = self._state.item(lay.S_X) - position - speed * self._model.behind_s
            self._put_motion(self._state.item(lay.S_X), speed)
        self._observe()

    def get_state(self) -> PlantState:
        """Present state, with the FMU's."""
        of_drives = super().get_state()
        memory = of_drives.memory, self._model.take_state(), self._offset_rad
        return PlantState(of_drives.values, memory)


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
