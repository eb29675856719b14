"""Model file, and the `machine:` block of a config: selects the machine by its `kind`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hilbench import strict_yaml
from hilbench.did_you_mean import expected_one_of
from hilbench.errors import UnusableInputError
from hilbench.files import write_whole
from hilbench.machine_kinds import DEFAULT, kinds, machine_part
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters, load_model

Machine = ModelParameters | ServoAxisParameters


def load_machine(path: str | Path) -> Machine:
    """Read a model file of any kind; one without `kind` is a web line's.

    Raises UnusableInputError (file, line, key, found, expected).
    """
    document = strict_yaml.load(Path(path))
    if not isinstance(document.data, Mapping) or "kind" not in document.data:
        return load_model(path)
    kind = document.data["kind"]
    if kind not in kinds():
        raise UnusableInputError(document.place(("kind",)), f"{kind!r}{expected_one_of(str(kind), kinds())}")
    model: Machine = strict_yaml.validate(document, machine_part(kind, "parameters"))
    return model


def write_model(path: str | Path, parameters: Machine) -> None:
    """Write a model file that `load_machine` reads back to an equal model. Raises UnusableInputError."""
    if isinstance(parameters, FmuAxisParameters):
        parameters = parameters.as_servo_axis()  # the estimate is outside the FMU's file, which can't be changed
    data: dict[str, Any] = parameters.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    if parameters.kind != DEFAULT:
        data = {"kind": parameters.kind, **data}
    data["effects"] = [entry.model_dump(mode="json", exclude_none=True) for entry in parameters.effects]
    write_whole(path, strict_yaml.text_of(data))
