"""The model file, and the `machine:` block of a config: which machine it is, by its `kind`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hilbench import strict_yaml
from hilbench.errors import UnusableInputError
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters, load_model
from hilbench.suggest import did_you_mean

Machine = ModelParameters | ServoAxisParameters

#: Kinds of machine by their names; a file without `kind` is the first.
KINDS = ("web_line", "servo_axis")


def load_machine(path: str | Path) -> Machine:
    """Read a model file of any kind. Raises UnusableInputError (file, line, key, found, expected)."""
    document = strict_yaml.load(Path(path))
    if not isinstance(document.data, Mapping) or document.data.get("kind", KINDS[0]) == "web_line":
        return load_model(path)
    kind = document.data["kind"]
    if kind not in KINDS:
        hint = did_you_mean(kind, KINDS) if isinstance(kind, str) else ""
        raise UnusableInputError(document.place(("kind",)), f"{kind!r}, expected {' or '.join(KINDS)}{hint}")
    return strict_yaml.validate(document, ServoAxisParameters)
