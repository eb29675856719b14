"""The model that a command is given: a model file, or a bench config, whose `model:` block is one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hilbench import strict_yaml
from hilbench.experiment.config import is_model, load
from hilbench.web.parameters import ModelParameters, load_model


def model_from(path: Path) -> ModelParameters:
    """Read it. Raises UnusableInputError (file, line, key, found, expected)."""
    return load(path)[0].model if holds_config(path) else load_model(path)


def holds_config(path: Path) -> bool:
    """Whether the file is a bench config, and no model file. Raises UnusableInputError for one that can't be read."""
    data = strict_yaml.load(path).data
    return isinstance(data, Mapping) and bool({"model", "include"} & data.keys()) and not is_model(data)
