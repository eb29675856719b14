"""The model that a command is given: a model file, or a bench config, whose `model:` block is one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hilbench import strict_yaml
from hilbench.experiment.config import load
from hilbench.web.parameters import ModelParameters, load_model


def model_from(path: Path) -> ModelParameters:
    """Read it. Raises UnusableInputError (file, line, key, found, expected)."""
    data = strict_yaml.load(path).data
    if isinstance(data, Mapping) and {"model", "include"} & data.keys() and "rollers" not in data:
        return load(path)[0].model
    return load_model(path)
