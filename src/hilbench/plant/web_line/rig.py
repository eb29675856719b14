"""The mechanics of the simulated hardware: two servo axes, and the load motor coupled to the second.

Axis 1 turns a flywheel alone. The shaft of axis 2 carries a flywheel and the load motor. There is no web here:
its pull is what the bench's load model commands the load motor to do. Quantities at the motor shafts, SI; forces
and amplitudes of effects are those at the web, as everywhere (radius and gear ratio convert them).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from hilbench.block import Block
from hilbench.plant.effects import EffectPlace, effect_problem, find_effect
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import DriveParameters, EffectEntry, LoadMotorParameters, per_item
from hilbench.plant.sampling import samples_per
from hilbench.plant.sensors import SensorParameters, Sensors
from hilbench.plant.web_line import kernel
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.line import set_effect
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.ports import read_ports, write_ports

Pair = FiniteFloat | Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]

_AXES = 2
_LOAD = 2  #: index of the load motor among the motors


class RigParameters(Block):
    """The simulated hardware. One value for both axes or a list of two. `matching` fills it from a model."""

    radius_m: Pair = 0.2
    gear_ratio: Pair = 5.0
    motor_inertia_kg_m2: Pair = 0.001
    #: What each motor turns besides itself (and, at axis 2, besides the load motor).
    flywheel_inertia_kg_m2: Pair = 1.167 / 25.0
    drives: DriveParameters
    load_motor: LoadMotorParameters = LoadMotorParameters()
    sensors: SensorParameters = SensorParameters()
    load_sensors: SensorParameters = SensorParameters()
    effects: tuple[EffectEntry, ...] = ()

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for name in ("radius_m", "gear_ratio"):
            if min(per_item(getattr(self, name), axis) for axis in (1, 2)) <= 0.0:
                raise ValueError(f"{name} = {getattr(self, name)!r}, expected more than 0")
        for axis in (1, 2):
            motor, flywheel = per_item(self.motor_inertia_kg_m2, axis), per_item(self.flywheel_inertia_kg_m2, axis)
            if min(motor, flywheel) < 0.0 or motor + flywheel <= 0.0:
                raise ValueError(f"axis {axis}: inertias {motor} and {flywheel} kg·m², expected 0 or more, not both 0")
        for position, entry in enumerate(self.effects):
            problem = effect_problem(entry.effect, entry.axis, EffectPlace.HARDWARE, _AXES)
            if problem:
                raise ValueError(f"effects, entry {position + 1}: {problem}")
        return self

    @classmethod
    def matching(
        cls,
        model: ModelParameters,
        load_motor: LoadMotorParameters | None = None,
        sensors: SensorParameters | None = None,
        effects: Sequence[EffectEntry] = (),
    ) -> RigParameters:
        """The stand on which a model's axes 1 and 2 turn as in the model: flywheels of J_roller/i².

        The load motor's inertia is taken off the second flywheel. Raises ValueError for a model without drives, with
        fewer than two axes, or a load motor heavier than the roller it stands for.
        """
        if model.drives is None or model.axis_count < _AXES:
            raise ValueError("the model has no drives or only one axis, expected two driven axes")
        load = load_motor or LoadMotorParameters()
        flywheels = [per_item(model.rollers.inertia_kg_m2, a) / model.gear_ratio(a) ** 2 for a in (1, 2)]
        flywheels[1] -= load.inertia_kg_m2
        if flywheels[1] < 0.0:
            raise ValueError(
                f"load motor of {load.inertia_kg_m2} kg·m², expected at most the reflected roller's "
                f"{flywheels[1] + load.inertia_kg_m2:.6g} kg·m²"
            )
        return cls(
            radius_m=[model.radius_m(1), model.radius_m(2)],
            gear_ratio=[model.gear_ratio(1), model.gear_ratio(2)],
            motor_inertia_kg_m2=[per_item(model.motors.inertia_kg_m2, 1), per_item(model.motors.inertia_kg_m2, 2)],
            flywheel_inertia_kg_m2=flywheels,
            drives=model.drives,
            load_motor=load,
            sensors=sensors or SensorParameters(),
            load_sensors=sensors or SensorParameters(),
            effects=tuple(effects),
        )


def pack_rig(stand: RigParameters, substeps: int = 1) -> Vector:
    """The kernel's parameter vector of a stand: two axes, three motors, no span."""
    layout = Layout(_AXES, _AXES + 1, 0)
    p = np.zeros(layout.parameter_size)
    p[[lay.W_AXES, lay.W_MOTORS, lay.W_SPANS]] = layout.axes, layout.motors, layout.spans
    p[lay.W_SAMPLE_TIME_S] = stand.drives.sample_time_s
    p[lay.W_SUBSTEPS] = substeps
    lay.clear_effects(p)
    for axis in (1, 2):
        ratio = per_item(stand.gear_ratio, axis) / per_item(stand.radius_m, axis)
        turned = per_item(stand.flywheel_inertia_kg_m2, axis) + (stand.load_motor.inertia_kg_m2 if axis == 2 else 0.0)
        row = layout.axis_rows(p)[axis - 1]
        row[lay.A_RADIUS_M] = per_item(stand.radius_m, axis)
        row[lay.A_MOTOR_MASS_KG] = per_item(stand.motor_inertia_kg_m2, axis) * ratio**2
        row[lay.A_ROLLER_MASS_KG] = turned * ratio**2
        motor = layout.motor_rows(p)[axis - 1]
        motor[lay.M_RAD_PER_M] = ratio
        motor[lay.M_AXIS] = axis - 1
        lay.write_drive(motor, stand.drives, axis)
    _write_load_motor(layout.motor_rows(p)[_LOAD], stand.load_motor, ratio)
    lay.write_entries(p, stand.effects)
    return p


def _write_load_motor(row: Vector, load: LoadMotorParameters, rad_per_m: float) -> None:
    row[lay.M_RAD_PER_M] = rad_per_m
    row[lay.M_AXIS] = 1
    row[lay.M_KP] = load.velocity_kp_Nm_s_per_rad
    row[lay.M_KI] = load.velocity_ki_Nm_per_rad
    row[lay.M_POSITION_KP] = 10.0
    row[lay.M_LIMIT_NM] = load.torque_limit_Nm
    row[lay.M_CURRENT_S] = load.current_loop_time_constant_s


class TestRig:
    """Two axes and the load motor on the second shaft; ports in the order axis 1, axis 2, load motor.

    A positive torque of any of them turns its shaft forward. The drives' loops act on the true motion; noise and
    resolution are in what the ports report. Starts at rest at position zero. Equal parameters, seed and set points
    give equal feedback, bit for bit. Raises ValueError unless there are three ports.
    """

    __test__ = False  # not a test, whatever pytest thinks of the name

    def __init__(self, parameters: RigParameters, ports: Sequence[MotorPort], seed: int = 0, *, substeps: int = 1):
        if len(ports) != _AXES + 1:
            raise ValueError(f"{len(ports)} ports, expected those of axis 1, axis 2 and the load motor")
        self._ports = tuple(ports)
        self._p = pack_rig(parameters, substeps)
        self._layout = Layout.of(self._p)
        self._state = np.zeros(self._layout.state_size)
        self._inputs, self._work = self._layout.new_inputs(), self._layout.new_work()
        self._out = np.zeros(self._layout.output_size)
        seeds = np.random.SeedSequence(seed).spawn(len(ports))
        kinds = (parameters.sensors, parameters.sensors, parameters.load_sensors)
        self._sensors = [Sensors(kind, child) for kind, child in zip(kinds, seeds, strict=True)]
        self._observe()

    def advance(self, duration_s: float) -> None:
        """Go on by a multiple of the drives' sample time with the ports' set points; write what the sensors show.

        Raises ValueError for another duration.
        """
        samples = samples_per(duration_s, self._p.item(lay.W_SAMPLE_TIME_S))
        read_ports(self._layout, self._ports, self._state, self._inputs)
        kernel.advance(self._p, self._state, self._inputs, self._work, samples)
        self._observe()

    def _observe(self) -> None:
        kernel.observe(self._p, self._state, self._inputs, self._work, self._out)
        write_ports(self._layout, self._p, self._ports, self._state, self._out)
        for port, sensors in zip(self._ports, self._sensors, strict=True):
            port.position_rad = sensors.position_rad(port.position_rad)
            port.velocity_rad_s = sensors.velocity_rad_s(port.velocity_rad_s)
            port.torque_Nm = sensors.torque_Nm(port.torque_Nm)

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return float(self._state[lay.S_COUNT] * self._p[lay.W_SAMPLE_TIME_S])

    @property
    def position_rad(self) -> Vector:
        """True positions of the three motors: what no sensor shows."""
        return self._out[self._layout.columns["x_m"]] * self._layout.motor_rows(self._p)[:, lay.M_RAD_PER_M]

    @property
    def velocity_rad_s(self) -> Vector:
        """True velocities of the three motors."""
        return self._out[self._layout.columns["v_m_s"]] * self._layout.motor_rows(self._p)[:, lay.M_RAD_PER_M]

    def set_effect(self, effect_id: str, axis: int | None = None, *, slot: int = 0, **parameters: float) -> None:
        """Give an axis an effect from now on. Raises ValueError, also for an effect of the web."""
        problem = effect_problem(effect_id, axis, EffectPlace.HARDWARE, _AXES)
        if problem:
            raise ValueError(problem)
        set_effect(self._p, effect_id, axis, slot, parameters)
        lay.refresh_modes(self._p, self._state)

    def clear_effect(self, effect_id: str, axis: int | None = None, *, slot: int = 0) -> None:
        """Make an effect neutral from now on. Raises as `set_effect`."""
        problem = effect_problem(effect_id, axis, EffectPlace.HARDWARE, _AXES)
        if problem:
            raise ValueError(problem)
        self.set_effect(effect_id, axis, slot=slot, **find_effect(effect_id).filled({}))
