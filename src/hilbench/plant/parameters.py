"""Parameters common to machines of every kind: drives, load motors, effects. SI, units in the key names.

A value that may differ from axis to axis is one number for all of them or a list.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Self, TypeVar

from pydantic import BeforeValidator, Field, FiniteFloat, model_validator

from hilbench.block import Block
from hilbench.plant.effect import MachineKind, Section
from hilbench.plant.effects import find_effect

Positive = Annotated[FiniteFloat, Field(gt=0.0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
GearRatio = Annotated[FiniteFloat, Field(ge=1e-4, le=1e4)]
Value = TypeVar("Value")
#: A list of effects that is there and empty (`effects:` and nothing after it) has none.
NOTHING_IS_NO_EFFECT = BeforeValidator(lambda value: () if value is None else value)


class DriveParameters(Block):
    """Control loops of the drives, at the motor: position P above velocity PI above a first-order current loop."""

    velocity_kp_Nm_s_per_rad: NotNegative | list[NotNegative] = Field(
        description="proportional gain of the velocity loop"
    )
    velocity_ki_Nm_per_rad: NotNegative | list[NotNegative] = Field(
        default=0.0, description="integral gain of the velocity loop"
    )
    position_kp_per_s: NotNegative | list[NotNegative] = Field(
        default=10.0, description="gain of the position loop, where a drive has one"
    )
    torque_limit_Nm: Positive | list[Positive] = Field(description="of the motor")
    current_loop_time_constant_s: NotNegative | list[NotNegative] = Field(
        default=0.0, description="the torque follows its command as a first-order lag"
    )
    sample_time_s: Annotated[Positive, Field(le=0.005)] = Field(
        default=0.001, description="of the velocity loop; the bus cycle is a multiple of it"
    )


class LoadMotorParameters(Block):
    """Load motor and its drive's torque loop, at the shaft."""

    inertia_kg_m2: float = Field(default=0.0, ge=0.0, description="of its rotor, on the shaft")
    torque_limit_Nm: float = Field(default=20.0, gt=0.0, description="of the motor")
    current_loop_time_constant_s: float = Field(
        default=0.001, ge=0.0, description="the torque follows its command as a first-order lag"
    )
    velocity_kp_Nm_s_per_rad: float = Field(
        default=1.5, ge=0.0, description="proportional gain of its velocity loop, used to stop"
    )
    velocity_ki_Nm_per_rad: float = Field(
        default=30.0, ge=0.0, description="integral gain of its velocity loop, used to stop"
    )
    position_kp_per_s: float = Field(default=10.0, ge=0.0, description="gain of its position loop, used by hand")


class EffectEntry(Block):
    """Effect with its parameter values, checked against `hilbench.plant.effects`."""

    #: Kind of machine whose effects it is checked against.
    machine_kind: ClassVar[MachineKind] = MachineKind.WEB_LINE

    effect: str = Field(description="its id in the vocabulary of effects")
    axis: int | None = Field(default=None, description="1 is the first roller's; for effects that belong to an axis")
    span: int | None = Field(
        default=None,
        description="1 is behind the first roller; for effects of what is there, which are else everywhere",
    )
    station: str | None = Field(
        default=None, description="for effects of a dancer, accumulator, idler or reel: its name"
    )
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict, description="its values, by name")

    @property
    def section(self) -> Section | None:
        """Section after an axis, from 1, or the name of a station; None: of an axis, or everywhere."""
        return self.span if self.station is None else self.station

    @model_validator(mode="after")
    def _known(self) -> Self:
        try:
            effect = find_effect(self.effect, self.machine_kind)
        except KeyError as error:
            raise ValueError(error.args[0]) from None
        problem = (
            effect.axis_problem(self.axis) or effect.section_problem(self.section) or effect.problem(self.parameters)
        )
        if problem:
            raise ValueError(problem)
        return self


def per_item(value: Value | list[Value], number: int) -> Value:
    """Value for item `number` (counted from 1) of a parameter that is one for all, or a list."""
    return value[number - 1] if isinstance(value, list) else value
