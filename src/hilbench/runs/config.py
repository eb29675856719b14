"""A whole config file: a bench and the experiment that runs on it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from hilbench import strict_yaml
from hilbench.block import Block
from hilbench.can.open import BusAddress
from hilbench.errors import UnusableInputError
from hilbench.files import write_whole, written_whole
from hilbench.runs.criteria import Criterion
from hilbench.runs.steps import ExperimentStep
from hilbench.topology.config import BenchConfig

#: Files of which a config is made, at most, each counted as often as it is included.
_MOST_FILES = 100
_MOST_KEYS = 50  # one below the other


class RecordingConfig(Block):
    """Selection of the samples that are recorded."""

    full_rate: Literal["always", "around_events"] = Field(
        default="always",
        description="always: every sample; around_events: every sample from 6 s before to 10 s after steps, ramps, "
        "events and alarms, and least, mean and largest value of each second elsewhere",
    )


class TraceConfig(Block):
    """The frames of the bus on disk."""

    keep_MB: float = Field(default=4000.0, gt=0.0, description="largest size of the trace; then it ends with a notice")
    part_MB: float = Field(default=256.0, gt=0.0, description="size of each file of the trace")
    compress: bool = Field(default=False, description="further files are packed (gzip) once they are full")


class ExperimentConfig(BenchConfig):
    """Bench, experiment steps and criteria, as one YAML file holds them."""

    recording: RecordingConfig = RecordingConfig()
    trace: TraceConfig = TraceConfig()
    steps: list[ExperimentStep] = Field(default=[], description="run one after the other, drives enabled")
    criteria: list[Criterion] = Field(default=[], description="what the run must show to pass")


def load(path: Path) -> tuple[ExperimentConfig, strict_yaml.Document]:
    """Read and validate a config file with what it includes.

    Raises UnusableInputError with file, line, key, what was found and what was expected.
    """
    document = _with_named_bus(read_document(path))
    return strict_yaml.validate(document, ExperimentConfig), document


def bus_of_folder(path: Path) -> BusAddress:
    """The embedded bus of a config that names none: that of its folder, the same for all configs there."""
    return BusAddress("embedded", "").in_folder(path.resolve().parent)


def _with_named_bus(document: strict_yaml.Document) -> strict_yaml.Document:
    """Two checkouts of a config must not meet: `embedded` alone is the bus of the config's folder."""
    location, data = ("bus", "address"), document.data
    bus = data.get("bus", {})
    given = bus.get("address", "embedded") if isinstance(bus, Mapping) else None
    if not isinstance(given, str) or given.strip().rstrip(":") not in ("embedded", "hilbench"):
        return document
    return document.with_value(location, str(bus_of_folder(document.path)), document.place(location))


def read_document(path: Path) -> strict_yaml.Document:
    """A config file on top of the files that its key `include` names (one, or a list; the later one counts).

    What a file names (includes, EDS files, tables) is looked for in its own folder. A model file counts as a config
    that has nothing but its `machine:`. Raises UnusableInputError with file and line; for files that include each other
    too.
    """
    return _read(path, (), [])


def files_of(path: Path) -> list[Path]:
    """The config, what it includes, and the files that they name, where these are there. Raises UnusableInputError as
    `read_document`."""
    read: list[Path] = []
    document = _read(path, (), read)
    named = (Path(name) for _, name in _named_files(document.data))
    return list(dict.fromkeys([*(each.resolve() for each in read), *(each for each in named if each.is_file())]))


def _read(path: Path, including: tuple[Path, ...], read: list[Path]) -> strict_yaml.Document:
    """Read a config file. `including`: the chain of files that include this one; `read`: all that were read."""
    document = strict_yaml.load(path)
    read.append(path)
    if not isinstance(document.data, Mapping):
        raise UnusableInputError(document.place(), "no mapping, expected a bench config")
    if is_model(document.data):
        document = document.below("machine")
    here = (*including, path.resolve())
    document = _with_files_of_its_folder(document)
    if "include" not in document.data:
        return document
    given, place = document.data["include"], document.place(("include",))
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UnusableInputError(place, f"'include' is {given!r}, expected a file name or a list of them")
    below: strict_yaml.Document | None = None
    for name in names:
        file = path.parent / name
        if not os.path.isfile(file):  # also of what can't be a name
            raise UnusableInputError(place, f"no file {file}, expected a config to include")
        if file.resolve() in here:
            raise UnusableInputError(place, f"'{name}' includes this file, expected no circle")
        if len(read) >= _MOST_FILES:
            raise UnusableInputError(place, f"more than {_MOST_FILES} files are included, expected fewer")
        included = _read(file, here, read)
        below = included if below is None else included.over(below)
    top = document.without("include")
    return top if below is None else top.over(below)


def is_model(data: Mapping[str, Any]) -> bool:
    """True if a file's data are a model, as `hilbench.plant.model_file.load_machine` reads it."""
    return "rollers" in data or "shaft" in data


def _with_files_of_its_folder(document: strict_yaml.Document) -> strict_yaml.Document:
    """Files that a config names are looked for in its own folder."""
    for location, name in list(_named_files(document.data)):
        place = document.place(location)
        try:
            file = (document.path.resolve().parent / name).resolve()
            file.is_file()
        except (OSError, ValueError) as error:
            key = ".".join(map(str, location))
            raise UnusableInputError(place, f"'{key}' is {name!r}, expected the name of a file ({error})") from error
        document = document.with_value(location, str(file), place)
    return document


def _named_files(data: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], str]]:
    for key, value in data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list) else ():
        if key in ("eds", "file", "history") and isinstance(value, str):
            yield (*at, key), value
        else:
            yield from _named_files(value, (*at, key))


def dump(config: BenchConfig, path: Path) -> None:
    """Write the resolved config, every default spelled out; `load` reads it back to a config that does the same.

    Tables and Python files of its steps are copied next to it, so that the folder is complete. Raises
    UnusableInputError when it cannot be written.
    """
    data: dict[str, Any] = config.model_dump(mode="json", exclude_none=True)
    for number, step in enumerate(data.get("steps", []), 1):
        for action in step.values():
            if "file" in action:
                source, name = Path(action["file"]), f"step{number}_{Path(action['file']).name}"
                with written_whole(path.parent / name) as partial:
                    shutil.copyfile(source, partial)
                action["file"] = name
    write_whole(path, strict_yaml.text_of(data))


def write_config_over(path: Path, files: Sequence[Path], changes: Sequence[str] = ()) -> None:
    """Write a config that includes others, the later one counting, under a name of its own (``…_extended``).

    `changes`, as of `load_with_overrides`, are in it but for those of the machine, which the last file has; of a list
    the whole. Raises UnusableInputError when it cannot be written, or the files make no config.
    """
    folder = path.resolve().parent
    names = [Path(os.path.relpath(file.resolve(), folder)).as_posix() for file in files]
    name = read_document(files[0]).data.get("name", files[0].stem)
    changed = _changed(files[0], changes) if changes else {}
    text = strict_yaml.text_of({"include": names, **changed, "name": f"{name}_extended"})
    write_whole(path, text)


def _changed(path: Path, changes: Sequence[str]) -> dict[str, Any]:
    """The values that changes give a config, without the rest of it."""
    document, alone = read_document(path), strict_yaml.Document(path, {}, {})
    locations = []
    for text in changes:
        location, value = parse_change(text)
        document = document.with_value(location, value, text)
        locations.append(tuple(takewhile(lambda key: isinstance(key, str), location)))
    for location in locations:
        if location[0] != "machine":
            alone = alone.with_value(location, document.value(location), str(path))
    return dict(alone.data)


@dataclass(frozen=True)
class LoadedConfig:
    """A config with the document it came from, so that later checks can name file and line."""

    config: ExperimentConfig
    document: strict_yaml.Document


def load_with_overrides(
    path: Path, *, bus: str | None = None, pace: str | None = None, seed: int | None = None, changes: Sequence[str] = ()
) -> LoadedConfig:
    """`load` with command-line overrides: `changes` are texts ``machine.web.width_m=0.6``.

    Raises UnusableInputError that names the file and line, or the option.
    """
    document = read_document(path)
    for text in changes:
        option, (location, value) = f"--set {text}", parse_change(text)
        document = document.with_value(location, value, option)
    options = {("bus", "address"): ("--bus", bus), ("pace",): ("--pace", pace), ("seed",): ("--seed", seed)}
    for location, (option, given) in options.items():
        if given is not None:
            document = document.with_value(location, given, option)
    document = _with_named_bus(document)
    return LoadedConfig(strict_yaml.validate(document, ExperimentConfig), document)


def parse_change(text: str) -> tuple[tuple[str | int, ...], Any]:
    """Location and value of ``load.web.youngs_modulus_Pa=10.5e9`` (a number is a position in a list).

    Raises UnusableInputError when it is no such text.
    """
    path, equals, value = text.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys) or len(keys) > _MOST_KEYS:
        raise UnusableInputError("--set", f"{text!r}, expected KEY=VALUE such as machine.web.youngs_modulus_Pa=9e9")
    location = tuple(int(key) if key.isdecimal() else key for key in keys)
    return location, strict_yaml.parse_value(value.strip(), f"--set {text}")
