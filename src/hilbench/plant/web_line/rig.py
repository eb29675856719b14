"""Mechanics of the simulated hardware: servo axes on a test rig, and load motors coupled to their shafts.

Each axis turns a flywheel; the shaft of an axis may carry load motors as well. There is no web here: its tension is
commanded to the load motors by the bench's load model. Quantities at the motor shafts, SI; forces and amplitudes of
effects are those at the web, as everywhere (radius and gear ratio convert them).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from hilbench.block import Block
from hilbench.compiled import Vector
from hilbench.plant.effect import EffectPlace
from hilbench.plant.effects import effect_problem, effects_of
from hilbench.plant.interface import Quantity, checked_name
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import DriveParameters, EffectEntry, LoadMotorParameters, per_item
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import KIND, SimulatedLine

OfAxes = FiniteFloat | Annotated[list[FiniteFloat], Field(min_length=1)]


class CoupledMotor(Block):
    """Load motor, and the axis whose shaft it turns with."""

    axis: int = Field(ge=1, description="on whose shaft it is, counted from 1")
    motor: LoadMotorParameters = LoadMotorParameters()


class RigParameters(Block):
    """Simulated hardware of N axes. One value for all axes or a list of N. `matching` fills it from a model."""

    axes: int = Field(ge=1)
    radius_m: OfAxes
    gear_ratio: OfAxes
    motor_inertia_kg_m2: OfAxes
    #: Load of each motor, without itself and the load motors on its shaft.
    flywheel_inertia_kg_m2: OfAxes
    drives: DriveParameters
    load_motors: tuple[CoupledMotor, ...] = ()
    sensors: SensorParameters = SensorParameters()
    load_sensors: SensorParameters = SensorParameters()
    effects: tuple[EffectEntry, ...] = ()

    @model_validator(mode="after")
    def _possible(self) -> Self:
        axes = range(1, self.axes + 1)
        for name in ("radius_m", "gear_ratio", "motor_inertia_kg_m2", "flywheel_inertia_kg_m2"):
            value = getattr(self, name)
            if isinstance(value, list) and len(value) != self.axes:
                raise ValueError(f"{name} has {len(value)} values, expected one or {self.axes}")
        for name in ("radius_m", "gear_ratio"):
            if min(per_item(getattr(self, name), axis) for axis in axes) <= 0.0:
                raise ValueError(f"{name} = {getattr(self, name)!r}, expected more than 0")
        for axis in axes:
            motor, flywheel = per_item(self.motor_inertia_kg_m2, axis), per_item(self.flywheel_inertia_kg_m2, axis)
            if min(motor, flywheel) < 0.0 or motor + flywheel <= 0.0:
                raise ValueError(f"axis {axis}: inertias {motor} and {flywheel} kg·m², expected 0 or more, not both 0")
        for number, coupled in enumerate(self.load_motors, 1):
            if coupled.axis > self.axes:
                raise ValueError(f"load motor {number} on axis {coupled.axis}, expected 1 to {self.axes}")
        for position, entry in enumerate(self.effects):
            problem = effect_problem(entry.effect, entry.axis, EffectPlace.HARDWARE, self.axes)
            if problem:
                raise ValueError(f"effects, entry {position + 1}: {problem}")
        return self

    def rotors_kg_m2(self, axis: int) -> float:
        """Inertia of the load motors on the shaft of `axis`."""
        return float(sum(coupled.motor.inertia_kg_m2 for coupled in self.load_motors if coupled.axis == axis))

    @classmethod
    def matching(
        cls,
        model: ModelParameters,
        load_motors: Sequence[CoupledMotor] = (),
        sensors: SensorParameters | None = None,
        effects: Sequence[EffectEntry] = (),
    ) -> RigParameters:
        """Rig on which a model's axes turn as in the model: flywheels of J_roller/i², of a reel with the web on it at
        the start.

        The inertia of load motors is taken off the flywheels on their shafts. Raises ValueError for a model without
        drives, or load motors heavier than the roller they replace.
        """
        if model.drives is None:
            raise ValueError("the model has no drives, expected 'drives'")
        axes = range(1, model.axis_count + 1)
        flywheels = [
            (per_item(model.rollers.inertia_kg_m2, a) + model.wound_inertia_kg_m2(a)) / model.gear_ratio(a) ** 2
            for a in axes
        ]
        for coupled in load_motors:
            if coupled.axis not in axes:
                raise ValueError(f"a load motor on axis {coupled.axis}, expected 1 to {model.axis_count}")
            reflected = flywheels[coupled.axis - 1]
            flywheels[coupled.axis - 1] -= coupled.motor.inertia_kg_m2
            if flywheels[coupled.axis - 1] < 0.0:
                raise ValueError(
                    f"load motor of {coupled.motor.inertia_kg_m2} kg·m², expected at most the reflected roller's "
                    f"{reflected:.6g} kg·m²"
                )
        return cls(
            axes=model.axis_count,
            radius_m=[model.radius_m(a) for a in axes],
            gear_ratio=[model.gear_ratio(a) for a in axes],
            motor_inertia_kg_m2=[per_item(model.motors.inertia_kg_m2, a) for a in axes],
            flywheel_inertia_kg_m2=flywheels,
            drives=model.drives,
            load_motors=tuple(load_motors),
            sensors=sensors or SensorParameters(),
            load_sensors=sensors or SensorParameters(),
            effects=tuple(effects),
        )


def pack_rig(rig: RigParameters, substeps: int = 1) -> Vector:
    """Parameter vector (P,) of a rig for the kernel: N axes, N motors and the load motors, no span.

    `substeps`: integration steps per sample time of the drives.
    """
    layout = Layout(rig.axes, rig.axes + len(rig.load_motors), 0)
    p = lay.new_parameters(layout, rig.drives.sample_time_s, substeps, KIND)
    for axis in range(1, rig.axes + 1):
        ratio = _rad_per_m(rig, axis)
        turned = per_item(rig.flywheel_inertia_kg_m2, axis) + rig.rotors_kg_m2(axis)
        row, motor = layout.axis_rows(p)[axis - 1], layout.motor_rows(p)[axis - 1]
        row.number, row.radius_m = axis, per_item(rig.radius_m, axis)
        row.m_per_turned_rad = row.radius_m
        row.motor_mass_kg = per_item(rig.motor_inertia_kg_m2, axis) * ratio**2
        row.roller_mass_kg = turned * ratio**2
        motor.rad_per_m, motor.axis = ratio, axis - 1
        lay.write_drive(motor, rig.drives, axis)
    for row, coupled in zip(layout.motor_rows(p)[rig.axes :], rig.load_motors, strict=True):
        lay.write_load_motor(row, coupled.motor, coupled.axis, _rad_per_m(rig, coupled.axis))
    lay.write_entries(p, rig.effects)
    return p


def _rad_per_m(rig: RigParameters, axis: int) -> float:
    return per_item(rig.gear_ratio, axis) / per_item(rig.radius_m, axis)


class TestRig(SimulatedLine):
    """N axes and the load motors on their shafts; ports in the order of the axes, then of the load motors.

    A positive torque of any of them turns its shaft forward. The drives' loops act on the true motion; noise and
    resolution are in the ports' feedback. Starts at rest at position zero. Equal parameters, seed and set points give
    equal feedback, bit for bit. Raises ValueError for another number of ports.
    """

    __test__ = False  # not a test, whatever pytest thinks of the name

    def __init__(self, parameters: RigParameters, ports: Sequence[MotorPort], seed: int = 0, *, substeps: int = 1):
        n, m = parameters.axes, parameters.axes + len(parameters.load_motors)
        if len(ports) != m:
            raise ValueError(f"{len(ports)} ports, expected those of {n} axes and {m - n} load motors")
        p = pack_rig(parameters, substeps)
        effects = [effect.id for effect in effects_of(KIND) if effect.enters(EffectPlace.HARDWARE)]
        sensors = [parameters.sensors] * n + [parameters.load_sensors] * (m - n)
        super().__init__(
            p,
            np.zeros(Layout.of(p).state_size),
            ports,
            "rad",
            effects,
            _values(parameters),
            sensors=sensors,
            seed=seed,
        )
        self._rig = parameters
        self._observe()

    def set_parameter(self, name: str, value: float) -> None:
        """Set a flywheel's inertia from now on. Raises ValueError for an unknown name or impossible value."""
        names = [quantity.name for quantity in self._description.parameters]
        axis = names.index(checked_name("parameter", name, self._description.parameters)) + 1
        turned = value + self._rig.rotors_kg_m2(axis)
        self._set_inertia(name, value, axis, turned * _rad_per_m(self._rig, axis) ** 2)

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Set an effect of an axis from now on. Raises ValueError, also for an effect of the web."""
        problem = effect_problem(effect_id, axis, EffectPlace.HARDWARE, self._layout.axes, section=section)
        if problem:
            raise ValueError(problem)
        super().set_effect(effect_id, axis, section=section, slot=slot, **parameters)


def _values(parameters: RigParameters) -> dict[Quantity, float]:
    """Changeable parameters with their values."""
    return {
        Quantity(f"flywheel_inertia{k}_kg_m2", "kg·m²", f"of what motor {k} turns without load motors, at its shaft"):
        per_item(parameters.flywheel_inertia_kg_m2, k)
        for k in range(1, parameters.axes + 1)
    }  # fmt: skip
