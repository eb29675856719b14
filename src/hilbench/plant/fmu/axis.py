"""FMU axis block `machine:` of `kind: fmu`: a servo axis whose mechanics are an FMU, driven by the motor's torque."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import Field, FiniteFloat, ModelWrapValidatorHandler, model_validator

from hilbench.block import Block
from hilbench.did_you_mean import did_you_mean
from hilbench.plant.fmu.config import FmuBlock, VariableName
from hilbench.plant.fmu.description import FmuDescription, Variable
from hilbench.plant.servo_axis.layout import PARAMETERS
from hilbench.plant.servo_axis.parameters import MotorParameters, ServoAxisParameters, ShaftParameters
from hilbench.plant.unit_names import unit_of_name


class ScaledVariable(Block):
    """Scaled parameter of the FMU: ours = factor · the FMU's + offset, in our unit."""

    variable: VariableName = Field(description="parameter of the FMU")
    factor: FiniteFloat = Field(default=1.0, description="for its value in its own unit")
    offset: FiniteFloat = Field(default=0.0, description="that is added")


class FmuAxisParameters(FmuBlock, ServoAxisParameters):
    """Servo axis whose mechanics are an FMU. Except for stepping, a servo axis with the FMU's parameters."""

    kind: Literal["fmu"] = Field(default="fmu", description="what machine this is")  # type: ignore[assignment]
    torque: VariableName = Field(description="input: torque of the motors on the shaft, N·m")
    position: VariableName = Field(description="output: angle of the motor's shaft, rad")
    speed: VariableName = Field(description="output: speed of the motor's shaft, rad/s")
    parameters: dict[str, VariableName | ScaledVariable] = Field(
        description="parameters of a servo axis that are some of the FMU: {inertia_kg_m2: J}; the twin finds inertia "
        "and friction, and gives them to its FMU"
    )
    shaft: ShaftParameters = Field(
        default=ShaftParameters(inertia_kg_m2=0.0), description="values at the start; those of the FMU unless given"
    )

    @model_validator(mode="wrap")
    @classmethod
    def _with_the_fmus_values(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Fill the shaft with the FMU's start values, where the config has none."""
        made = handler(data)
        if not isinstance(data, Mapping):
            return made
        found, given = made.variables(), made.shaft.model_dump(exclude_unset=True) if "shaft" in data else {}
        starts = {
            name: variable.si(variable.start)
            for name, variable in found.parameters.items()
            if variable.start is not None
        }
        shaft = ShaftParameters.model_validate({"inertia_kg_m2": 0.0} | starts | given)
        if shaft.inertia_kg_m2 <= 0.0:
            raise ValueError("an inertia above 0: 'parameters: inertia_kg_m2' that the FMU has, or 'shaft:' with it")
        return made.model_copy(update={"shaft": shaft})

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.motor != MotorParameters() or self.effects:
            raise ValueError("no 'motor:' and no 'effects:': all that turns, and what it does, is in the FMU")
        unknown = [name for name in self.parameters if name not in PARAMETERS]
        if unknown:
            hint = did_you_mean(unknown[0], PARAMETERS)
            raise ValueError(f"'parameters' of {', '.join(PARAMETERS)}; '{unknown[0]}' is none{hint}")
        return self

    def variables(self) -> AxisVariables:
        """Named variables, in SI units. Raises ValueError for a missing one, or one in other units."""
        found = self.description()
        return AxisVariables(
            found.find(self.torque, "input", "N·m"),
            found.find(self.position, "output", "rad"),
            found.find(self.speed, "output", "rad/s"),
            {name: _parameter(found, name, given) for name, given in self.parameters.items()},
        )

    def as_servo_axis(self) -> ServoAxisParameters:
        """Servo axis without the FMU, as the reference model of a diagnosis."""
        return ServoAxisParameters(shaft=self.shaft, motor=self.motor, drives=self.drives)


class AxisVariables:
    """Variables of an FMU that is a servo axis; parameters by our names."""

    def __init__(self, torque: Variable, position: Variable, speed: Variable, parameters: dict[str, Variable]) -> None:
        self.torque, self.position, self.speed, self.parameters = torque, position, speed, parameters


def _parameter(found: FmuDescription, name: str, given: str | ScaledVariable) -> Variable:
    if isinstance(given, str):
        variable = found.find(given, "parameter", unit_of_name(name))
    else:
        variable = found.find(given.variable, "parameter", "").scaled(given.factor, given.offset)
    if not variable.settable:
        raise ValueError(f"a tunable parameter for '{name}', which the twin changes; '{variable.name}' is fixed")
    return variable
