"""The model that a command is given: a model file, or a bench config, whose `machine:` block is one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hilbench import strict_yaml
from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import Machine, load_machine
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import ONLY_DRIVEN
from hilbench.runs.config import ExperimentConfig, is_model, load


def any_model_from(path: Path) -> Machine:
    """Read it. Raises UnusableInputError (file, line, key, found, expected)."""
    config = config_from(path)
    return load_machine(path) if config is None else config.machine


def model_from(path: Path) -> Machine:
    """Model for commands without support of idlers, dancers, accumulators or reels. Raises UnusableInputError."""
    machine = any_model_from(path)
    if isinstance(machine, ModelParameters) and machine.stations is not None:
        found = "a line with idlers, dancers, accumulators or reels"
        raise UnusableInputError(strict_yaml.load(path).place(("stations",)), f"{found}, expected {ONLY_DRIVEN}")
    return machine


def web_line_of(machine: Machine, path: Path) -> ModelParameters:
    """The machine read from this file, for what knows web lines only. Raises UnusableInputError."""
    if isinstance(machine, ModelParameters):
        return machine
    raise UnusableInputError(path, f"the machine is a {machine.kind}, expected a web_line: this command knows no other")


def config_from(path: Path) -> ExperimentConfig | None:
    """The bench config, if the file is one. Raises UnusableInputError as `model_from`."""
    data = strict_yaml.load(path).data
    if isinstance(data, Mapping) and {"machine", "include"} & data.keys() and not is_model(data):
        return load(path)[0]
    return None
