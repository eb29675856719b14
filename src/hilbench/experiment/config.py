"""A whole config file: a bench and the experiment that runs on it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, ValidationError

from hilbench import strict_yaml
from hilbench.bench.config import BenchConfig
from hilbench.errors import UnusableInputError
from hilbench.experiment.criteria import Criterion
from hilbench.experiment.steps import ExperimentStep


class ExperimentConfig(BenchConfig):
    """Bench, experiment steps and criteria, as one YAML file holds them."""

    steps: list[ExperimentStep] = Field(default=[], description="run one after the other, drives enabled")
    criteria: list[Criterion] = Field(default=[], description="what the run must show to pass")


def load(path: Path) -> tuple[ExperimentConfig, strict_yaml.Document]:
    """Read and validate a config file; relative EDS paths are taken from its folder.

    Raises UnusableInputError with file, line, key, what was found and what was expected.
    """
    document = strict_yaml.load(path)
    context = {"folder": Path(path).resolve().parent}
    return strict_yaml.validate(document, ExperimentConfig, context=context), document


def dump(config: BenchConfig, path: Path) -> None:
    """Write the resolved config, every default spelled out; `load` reads it back to an equal config."""
    data: dict[str, Any] = config.model_dump(mode="json", exclude_none=True)
    path.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True), encoding="utf-8")


@dataclass(frozen=True)
class LoadedConfig:
    """A config with the document it came from, so that later checks can name file and line."""

    config: ExperimentConfig
    document: strict_yaml.Document


def load_with_overrides(
    path: Path, *, bus: str | None = None, pace: str | None = None, seed: int | None = None
) -> LoadedConfig:
    """`load`, then what the command line says instead. Raises UnusableInputError, naming the option."""
    config, document = load(path)
    data = config.model_dump()
    if bus is not None:
        data["bus"]["address"] = bus
    if pace is not None:
        data["pace"] = pace
    if seed is not None:
        data["seed"] = seed
    try:
        return LoadedConfig(ExperimentConfig.model_validate(data), document)
    except ValidationError as error:
        first = error.errors()[0]
        option = {"bus": "--bus", "pace": "--pace", "seed": "--seed"}.get(str(first["loc"][0]), "config")
        raise UnusableInputError(option, f"{first['input']!r}: {first['msg'].removeprefix('Value error, ')}") from error
