"""Servo axis as a plant, in the line's kernel: the closed model that the twin simulates, and the simulated hardware."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from hilbench.compiled import REAL, VECTOR, Vector, entry_point
from hilbench.plant.interface import Motor, PlantDescription, Quantity, checked_name
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import IDS, KIND
from hilbench.plant.servo_axis.layout import PARAMETERS
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.web_line import laws, records
from hilbench.plant.web_line.layout import refresh_modes
from hilbench.plant.web_line.simulated import SimulatedLine

_TORQUE = Quantity("external_torque_Nm", "N·m", "torque on the shaft from outside, forward")


#: look(parameters, time_s): factor on the inertia then, dry friction at standstill, and offset of the reported torque,
#: N·m.
@entry_point(VECTOR, REAL)
def look(p: Vector, time_s: float) -> tuple[float, float, float]:
    line = records.of_parameters(p)
    axis = records.axis(line, 0)
    factor = laws.inertia_factor_at(axis, time_s, p[lay.P_SAMPLE_TIME_S])
    return factor, laws.breakaway_N(axis), records.motor(line, 0).torque_offset.offset_Nm


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


class Shaft(SimulatedLine):
    """Shaft with its motors; angle and torques at the motor shaft. Starts at rest at position zero.

    `step` takes the set points from the ports and writes the feedback to them; without ports every motor is off. Motor
    2 is the load motor, if any. `sensors` of the motors, with noise by `seed`.
    """

    kind = KIND

    def __init__(
        self,
        parameters: ServoAxisParameters,
        load_motor: LoadMotorParameters | None,
        ports: Sequence[MotorPort],
        sensors: Sequence[SensorParameters] = (),
        seed: int = 0,
    ) -> None:
        p = lay.pack(parameters, load_motor)
        super().__init__(p, lay.new_state(p), ports, "rad", IDS, {}, sensors=sensors, seed=seed)
        columns = self._layout.columns
        places = (columns[name].start for name in ("x_m", "v_m_s", "mean_tau_Nm"))
        torques = columns["tau_Nm"]
        shown = [*places, *range(torques.start, torques.stop)]
        self._describe_as(_description(self._layout.motors), [(column, 1.0) for column in shown])
        self._observe()

    @property
    def inertia_factor(self) -> float:
        """Present factor on the inertia by effects."""
        return float(look(self._p, self.time_s)[0])

    def parameter(self, name: str) -> float:
        """Present value of a parameter, without effects. Raises ValueError for an unknown name."""
        return self._p.item(PARAMETERS[_known(name)][1])

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on. Raises ValueError for an unknown name or an impossible value."""
        value = checked_parameter(name, value)
        self._p[PARAMETERS[name][1]] = value
        refresh_modes(self._p, self._state)

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
        super().set_effect(effect_id, axis, section=section, slot=slot, **parameters)
        if not self._twists(0):
            self._state[lay.S_X_BEHIND] = self._state[lay.S_X]


class ServoAxis(Shaft):
    """Closed model, a `Plant` with one motor. Raises ValueError for unfit ports, or a port on a model without
    drives."""

    def __init__(self, parameters: ServoAxisParameters, ports: Sequence[MotorPort] | None = None) -> None:
        if ports is not None and (parameters.drives is None or len(ports) != 1):
            raise ValueError(f"{len(ports)} ports, expected a model with drives and one port")
        self.parameters = parameters
        super().__init__(parameters, None, ports or ())


class ServoRig(Shaft):
    """Simulated hardware, a `Plant`: the real shaft with two motors and their sensors; ports of axis and load motor.

    A positive torque of either turns the shaft forward. The drives' loops act on the true motion; noise and resolution
    are in the ports' feedback. Equal parameters, seed and set points give equal feedback, bit for bit. Emulation by the
    load motor (`hilbench.plant.servo_axis.emulation`) is not included. Raises ValueError unless there are two ports and
    the axis has drives.
    """

    def __init__(self, parameters: ServoRigParameters, ports: Sequence[MotorPort], seed: int = 0) -> None:
        if len(ports) != 2 or parameters.axis.drives is None:
            raise ValueError(f"{len(ports)} ports, expected those of the axis and the load motor, and drives")
        sensors = parameters.sensors, parameters.load_sensors
        super().__init__(parameters.axis, parameters.load_motor, ports, sensors, seed)


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
