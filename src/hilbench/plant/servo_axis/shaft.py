"""Base of the closed model and the simulated hardware of a servo axis: the kernel as a plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np

from hilbench.cycle_program import CompiledStage
from hilbench.plant import drive_loops as loops
from hilbench.plant.interface import Motor, PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.sampling import locked_sample_time_s, samples_per
from hilbench.plant.sensor_rows import chained_with_noise, silence
from hilbench.plant.sensors import SensorNoise
from hilbench.plant.servo_axis import kernel, rig_cycle
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import IDS, KIND, find
from hilbench.plant.servo_axis.layout import PARAMETERS, Vector
from hilbench.plant.servo_axis.parameters import ServoAxisParameters

_TORQUE = Quantity("external_torque_Nm", "N·m", "torque on the shaft from outside, forward")


class ShaftStep(NamedTuple):
    """Arguments of `rig_cycle.step`."""

    samples: int  #: of the drives
    vectors: tuple[Vector, ...]  #: of its table; kept by the caller
    silence: Vector  #: zeros in place of noise


def checked_parameter(name: str, value: float) -> float:
    """Possible value of a parameter. Raises ValueError."""
    quantity = PARAMETERS[_known(name)][0]
    positive, any_sign = name == "inertia_kg_m2", quantity.unit == "rad"
    if not isfinite(value) or (value <= 0.0 if positive else value < 0.0 and not any_sign):
        expected = "more than 0" if positive else "a finite number" if any_sign else "0 or more"
        raise ValueError(f"{name} = {value!r} {quantity.unit}, expected {expected}")
    return value


def _known(name: str) -> str:
    if name in PARAMETERS:  # every cycle
        return name
    return checked_name("parameter", name, (quantity for quantity, _ in PARAMETERS.values()))


class Shaft:
    """Shaft with its motors; angle and torques at the motor shaft. Starts at rest at position zero.

    `step` takes the set points from the ports and writes the feedback to them; without ports every motor is off.
    """

    _noise: SensorNoise | None = None  # of one with sensors, and what these are (`rig_cycle`):
    _sensor_figures: Vector

    def __init__(
        self,
        parameters: ServoAxisParameters,
        load_motor: LoadMotorParameters | None,
        ports: Sequence[MotorPort],
        substeps: int,
    ) -> None:
        self._p = lay.pack(parameters, load_motor, substeps)
        self._sample_time_s = self._p.item(lay.P_SAMPLE_TIME_S)
        self._ports = tuple(ports)
        self._state = lay.new_state(self._p)
        self._inputs = lay.new_inputs(self._p)
        self._out = np.zeros(lay.output_size(self._p))
        self._description = _description(lay.motor_count(self._p))
        self._output_names = [quantity.name for quantity in self._description.outputs]
        self._observe()

    def describe(self) -> PlantDescription:
        """Description: one axis in rad; motor 2 is the load motor, if any."""
        return self._description

    @property
    def packed(self) -> Vector:
        """Parameter vector of the kernel, including effects."""
        return self._p

    @property
    def inputs(self) -> Vector:
        """Inputs of the kernel."""
        return self._inputs

    @property
    def inertia_factor(self) -> float:
        """Present factor on the inertia by effects."""
        return float(kernel.look(self._p, self.time_s)[0])

    @property
    def ports(self) -> tuple[MotorPort, ...]:
        """Port of each motor; empty if every motor is off for good."""
        return self._ports

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return float(self._state[lay.S_COUNT] * self._p[lay.P_SAMPLE_TIME_S])

    def lock_to(self, duration_s: float) -> None:
        """Set the drives' sample time to the nearest to the model's of which `duration_s` is a multiple."""
        time_s, sample_s = self.time_s, locked_sample_time_s(duration_s, self._sample_time_s)
        self._p[lay.P_SAMPLE_TIME_S] = sample_s
        self._state[lay.S_COUNT] = round(time_s / sample_s)

    def step(self, duration_s: float) -> None:
        """Step by a multiple of the drives' sample time, with the ports' set points held.

        Raises ValueError for another duration.
        """
        samples = samples_per(duration_s, self._p.item(lay.P_SAMPLE_TIME_S))
        self._read_ports()
        for state, _ in zip(lay.motor_states(self._state), self._ports, strict=False):
            state[loops.LIMITED] = 0.0
        self._go(samples)
        self._observe()

    def _read_ports(self) -> None:
        for row, port in zip(lay.motor_inputs(self._inputs), self._ports, strict=False):
            row[:] = port.mode, port.setpoint, port.slope, port.torque_limit_Nm

    def steps_in_modes(self, set_points: Vector, duration_s: float, shown: Vector) -> CompiledStage | None:
        """`step` with set points (M,) in place of the ports', whose modes and limits are kept; the feedback goes into
        `shown`, (5 M,): position, velocity, torque, reference, torque limited.

        The ports are not updated; the caller keeps the vectors. Raises ValueError as `step`.
        """
        of, noise = self.step_in_vectors(duration_s, set_points, shown), self._noise
        numbers = silence(len(self._ports)) if noise is None else (noise.rows, noise.next)
        return chained_with_noise(rig_cycle.step_by, of.samples, (*of.vectors, *numbers), noise)

    def step_in_vectors(self, duration_s: float, set_points: Vector, shown: Vector) -> ShaftStep:
        """Step arguments for compiled callers, for a shaft without sensors."""
        samples = samples_per(duration_s, self._p.item(lay.P_SAMPLE_TIME_S))
        self._read_ports()
        motors = len(self._ports)
        sensors = np.zeros(rig_cycle.SENSOR * motors) if self._noise is None else self._sensor_figures
        kept = self._p, self._state, self._inputs, self._out, set_points, sensors, shown
        return ShaftStep(samples, kept, silence(motors)[0][0])

    def _go(self, samples: int) -> None:
        kernel.advance(self._p, self._state, self._inputs, samples)

    def _observe(self) -> None:
        kernel.observe(self._p, self._state, self._out)
        position, velocity, _, *torques = self._out.tolist()
        for port, torque, state in zip(self._ports, torques, lay.motor_states(self._state), strict=False):
            port.position_rad = position
            port.velocity_rad_s = velocity
            port.torque_Nm = torque
            port.reference = float(state[loops.REFERENCE])
            port.torque_limited = bool(state[loops.LIMITED] != 0.0)

    def outputs(self) -> dict[str, float]:
        """Motion of the shaft and the motors' torques as their drives report them, without sensors."""
        return dict(zip(self._output_names, self._out.tolist(), strict=True))

    def get_state(self) -> PlantState:
        """Present state: motion and torques by name, and the drives' loops."""
        torques = lay.motor_states(self._state)[:, loops.TORQUE_NM].tolist()
        values = [self._state.item(lay.S_X), self._state.item(lay.S_V), *torques]
        names = (quantity.name for quantity in self.describe().states)
        return PlantState(dict(zip(names, values, strict=True)), self._memory())

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of an equal shaft, or transfer the states given by name. Raises ValueError."""
        if isinstance(state, PlantState):
            self._restore(state.memory)
        else:
            for name, value in state.items():
                self._transfer(checked_name("state", name, self.describe().states), value)
            self._refresh_direction()
            self._observe()

    def _memory(self) -> object:
        return self._state.copy()

    def _restore(self, memory: object) -> None:
        if not isinstance(memory, np.ndarray) or memory.shape != self._state.shape:
            raise ValueError("a state of another machine, expected one of an equal servo axis")
        self._state[:] = memory
        self._observe()

    def _transfer(self, name: str, value: float) -> None:
        if not np.isfinite(value):
            raise ValueError(f"{name} = {value!r}, expected a finite number")
        if name == "x1_rad":
            self._state[lay.S_X] = value
        elif name == "v1_rad_s":
            self._state[lay.S_V] = value
        else:
            motor = lay.motor_states(self._state)[int(name.removeprefix("tau").removesuffix("_Nm")) - 1]
            motor[[loops.TORQUE_NM, loops.COMMAND_NM, loops.INTEGRAL_NM]] = value

    def _refresh_direction(self) -> None:
        speed = self._state.item(lay.S_V)
        self._state[lay.S_DIRECTION] = (speed > 0.0) - (speed < 0.0)

    def parameter(self, name: str) -> float:
        """Present value of a parameter, without effects. Raises ValueError for an unknown name."""
        return self._p.item(PARAMETERS[_known(name)][1])

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on. Raises ValueError for an unknown name or an impossible value."""
        value = checked_parameter(name, value)
        self._p[PARAMETERS[name][1]] = value
        self._refresh_direction()

    def set_input(self, name: str, value: float) -> None:
        """Set the external torque from now on. Raises ValueError for an unknown name or a value that is not finite."""
        checked_name("input", name, (_TORQUE,))
        if not np.isfinite(value):
            raise ValueError(f"{name} = {value!r} N·m, expected a finite number")
        self._inputs[lay.U_TORQUE_NM] = value

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Set an effect of the axis from now on. Raises ValueError for an impossible one."""
        lay.check_effect(effect_id, axis, slot, parameters)
        _refuse_section(effect_id, section)
        changed = self._p.copy()
        lay.write_effect(changed, effect_id, slot, find(effect_id).filled(parameters).values())
        lay.check_delay(changed)
        self._p[:] = changed
        self._refresh_direction()

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Make an effect neutral from now on. Raises as `set_effect`."""
        lay.check_effect(effect_id, axis, slot, find(effect_id).filled({}) if effect_id in IDS else {})
        _refuse_section(effect_id, section)
        lay.write_effect(self._p, effect_id, slot, find(effect_id).filled({}).values())
        self._refresh_direction()


def _description(motors: int) -> PlantDescription:
    motion = (
        Quantity("x1_rad", "rad", "position of the motor shaft"),
        Quantity("v1_rad_s", "rad/s", "speed of the motor shaft"),
    )
    mean = Quantity("tau1_mean_Nm", "N·m", "mean torque of motor 1 in the last step")
    torques = tuple(Quantity(f"tau{k}_Nm", "N·m", f"torque of motor {k}") for k in range(1, motors + 1))
    return PlantDescription(
        kind=KIND,
        position_unit="rad",
        axes=1,
        motors=(Motor(axis=1, rad_per_unit=1.0),) * motors,
        states=motion + torques,
        inputs=(_TORQUE,),
        outputs=(*motion, mean, *torques),
        parameters=tuple(quantity for quantity, _ in PARAMETERS.values()),
        effects=IDS,
    )


def _refuse_section(effect_id: str, section: int | None) -> None:
    problem = find(effect_id).section_problem(section)
    if problem:
        raise ValueError(problem)
