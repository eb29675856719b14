"""Servo axis block `machine:` (or model file) of `kind: servo_axis`: one shaft, its motor and its drive.

All quantities are those at the motor shaft, SI, units in the key names: the angle is the motor's, and loads behind a
gear are referred to the motor (inertia divided by i², torques by i). The gear ratio is only the number of motor turns
per turn of the unbalance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, FiniteFloat, field_validator, model_validator

from hilbench.block import Block
from hilbench.plant.effect import MachineKind
from hilbench.plant.parameters import (
    NOTHING_IS_NO_EFFECT,
    DriveParameters,
    GearRatio,
    LoadMotorParameters,
    NotNegative,
)
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis.effects import ShaftEffect, find

Phase = Annotated[FiniteFloat, Field(ge=-7.0, le=7.0)]


class ShaftParameters(Block):
    """Load of the motor."""

    inertia_kg_m2: NotNegative = Field(description="of what the motor turns, without its rotor (motor.inertia_kg_m2)")
    coulomb_friction_Nm: NotNegative = Field(default=0.0, description="dry friction; it holds a shaft at rest")
    viscous_friction_Nm_s_per_rad: NotNegative = Field(default=0.0, description="friction in proportion to the speed")
    unbalance_Nm: NotNegative = Field(
        default=0.0, description="amplitude of the torque A·sin(phi + phi0), phi the angle of what is unbalanced"
    )
    unbalance_phase_rad: Phase = Field(default=0.0, description="phi0: where position zero is in that sine")
    gear_ratio: GearRatio = Field(default=1.0, description="turns of the motor per turn of what is unbalanced")


class MotorParameters(Block):
    """Motor of the axis."""

    inertia_kg_m2: NotNegative = Field(default=0.0, description="of its rotor")


class ServoAxisParameters(Block):
    """Servo axis. Immutable; `model_copy(update=…)` varies it."""

    #: Unit of its axis's position; speeds are per second.
    position_unit: ClassVar[Literal["m", "rad"]] = "rad"
    #: Kind that selects effects, signals and metrics.
    machine_kind: ClassVar[MachineKind] = MachineKind.SERVO_AXIS

    kind: Literal["servo_axis"] = Field(default="servo_axis", description="what machine this is")
    shaft: ShaftParameters
    motor: MotorParameters = MotorParameters()
    drives: DriveParameters | None = None
    effects: Annotated[tuple[ShaftEffect, ...], NOTHING_IS_NO_EFFECT] = Field(
        default=(), description="what else the model has, of the vocabulary of effects"
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.inertia_kg_m2 <= 0.0:
            raise ValueError("the shaft has no inertia, expected that of shaft or motor above 0")
        for name, value in self.drives or ():
            if isinstance(value, list) and len(value) != 1:
                raise ValueError(f"{name} has {len(value)} values, expected one: the machine has one drive")
        return self

    @field_validator("effects")
    @classmethod
    def _effects_fit(cls, entries: tuple[ShaftEffect, ...]) -> tuple[ShaftEffect, ...]:
        used: Counter[str] = Counter()
        for position, entry in enumerate(entries):
            effect = find(entry.effect)
            problem = effect.axis_problem(entry.axis, 1)
            used[effect.id] += 1
            if problem is None and used[effect.id] > effect.slots:
                problem = f"effect '{effect.id}' is given more than {effect.slots} times"
            if problem:
                raise ValueError(f"entry {position + 1}: {problem}")
        return entries

    @property
    def axis_count(self) -> int:
        """Driven axes: one."""
        return 1

    @property
    def span_count(self) -> int:
        """Free spans of a web: none."""
        return 0

    def motor_rad_per_unit(self, axis: int) -> float:
        """Motor angle per unit of the axis's position, which is the motor's."""
        return 1.0

    def gear_ratio(self, axis: int) -> float:
        """Turns of the motor per turn of the unbalance."""
        return self.shaft.gear_ratio

    @property
    def inertia_kg_m2(self) -> float:
        """Inertia J of motor and load, without effects."""
        return self.motor.inertia_kg_m2 + self.shaft.inertia_kg_m2


class ServoRigParameters(Block):
    """Simulated hardware of a servo axis. `matching` fills it from a model."""

    axis: ServoAxisParameters  #: as built, without the load motor's rotor
    load_motor: LoadMotorParameters = LoadMotorParameters()
    sensors: SensorParameters = SensorParameters()
    load_sensors: SensorParameters = SensorParameters()

    @property
    def inertia_kg_m2(self) -> float:
        """Total inertia as built, including the load motor's rotor; without effects."""
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
        """Rig on which a model's drive turns `shaft`; by default the model's, so that nothing is emulated.

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
