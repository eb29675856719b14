"""FMU configuration: its file, the mapping of its variables, and its communication steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from hilbench.block import Block
from hilbench.errors import UnusableInputError
from hilbench.plant.fmu.description import FmuDescription, Variable, read_fmu
from hilbench.plant.parameters import Positive
from hilbench.plant.unit_names import unit_of_name

VariableName = Annotated[str, Field(min_length=1, max_length=200)]


class FmuBlock(Block):
    """Common settings of every use of an FMU."""

    file: Path = Field(description="the FMU (FMI 2 or 3, co-simulation); a relative path is from the config's folder")
    step_s: Positive | None = Field(
        default=None,
        description="communication step; else what time has to go by, or of an FMU that takes no other steps, the one "
        "it asks for",
    )
    timeout_s: Annotated[Positive, Field(le=60.0)] = Field(
        default=2.0, description="how long it may take to answer before that is a fault"
    )

    def description(self) -> FmuDescription:
        """Description in the file. Raises ValueError for an unusable one."""
        try:
            return read_fmu(self.file)
        except UnusableInputError as error:
            raise ValueError(f"{error.problem} ({self.file})") from None

    def communication_step_s(self, natural_s: float) -> float | None:
        """Fixed communication step of the FMU; None: steps of any length.

        `natural_s`: the caller's own step.
        """
        if self.step_s is not None:
            return self.step_s
        description = self.description()
        return None if description.any_step else description.step_s or natural_s


class FmuLoadConfig(FmuBlock):
    """Settings `load: fmu:` of an FMU that load motors emulate: motion of the driven axes in, torques out."""

    positions: list[VariableName] = Field(
        default=[], description="inputs: measured position of each driven axis, in the machine's unit (m or rad)"
    )
    speeds: list[VariableName] = Field(
        default=[], description="inputs: speed of each driven axis over the last cycle, by its positions"
    )
    torques: list[VariableName] = Field(
        min_length=1, description="outputs: torque at the shaft of each load motor, N·m, as it has to act there"
    )
    outputs: dict[str, VariableName] = Field(
        default={}, description="outputs by the names of the machine's, {OURS: THEIRS}: what is recorded as the truth"
    )
    parameters: dict[str, VariableName] = Field(
        default={}, description="parameters by the names of the machine's, {OURS: THEIRS}: can be set by path"
    )

    def problems(self, axes: int, load_motors: int | None, unit: str) -> Iterator[str]:
        """Reasons why the FMU can't be emulated on a machine with so many axes and load motors, positions in `unit`."""
        if not self.positions and not self.speeds:
            yield "'fmu.positions' or 'fmu.speeds': the inputs that take the motion"
        for key, names in (("positions", self.positions), ("speeds", self.speeds)):
            if names and len(names) != axes:
                yield f"'fmu.{key}' of {axes} axes, not of {len(names)}"
        if load_motors is not None and len(self.torques) != load_motors:
            yield f"'fmu.torques' of {load_motors} load motors, not of {len(self.torques)}"
        try:
            self.variables(unit)
        except ValueError as error:
            yield str(error)

    def variables(self, unit: str) -> LoadVariables:
        """Named variables, in SI units. Raises ValueError for a missing one, or one in other units."""
        found = self.description()

        def named(key: str, names: Mapping[str, str]) -> dict[str, Variable]:
            return {ours: _find(found, name, key, unit_of_name(ours)) for ours, name in names.items()}

        return LoadVariables(
            [_find(found, name, "input", unit) for name in self.positions],
            [_find(found, name, "input", f"{unit}/s") for name in self.speeds],
            [_find(found, name, "output", "N·m") for name in self.torques],
            named("output", self.outputs),
            named("parameter", self.parameters),
        )


def _find(description: FmuDescription, name: str, causality: str, unit: str) -> Variable:
    return description.find(name, causality, unit)


class LoadVariables:
    """Variables of an FMU that load motors emulate."""

    def __init__(
        self,
        positions: list[Variable],
        speeds: list[Variable],
        torques: list[Variable],
        outputs: dict[str, Variable],
        parameters: dict[str, Variable],
    ) -> None:
        self.positions, self.speeds, self.torques = positions, speeds, torques
        self.outputs, self.parameters = outputs, parameters
