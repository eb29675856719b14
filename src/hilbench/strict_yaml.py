"""YAML as a config file needs it: repeated keys refused, ``1e-3`` a number, every value with its line.

Plain PyYAML keeps the last of two equal keys and reads ``1e-3`` as a string (it follows YAML 1.1,
whose floats need a dot and a signed exponent); ``yes``/``no``/``on``/``off`` are strings here, as in YAML 1.2.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from hilbench.errors import UnusableInputError

Location = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)


class _Loader(yaml.SafeLoader):
    """Safe loader with the scalar types of YAML 1.2's core schema."""


_FLOAT = re.compile(
    r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$"
)
_INT = re.compile(r"^[-+]?[0-9]+$|^0x[0-9a-fA-F]+$|^0o[0-7]+$")
_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern) for tag, pattern in resolvers if tag in ("tag:yaml.org,2002:null", "tag:yaml.org,2002:merge")
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", _INT, list("-+0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))


@dataclass(frozen=True)
class Document:
    """A parsed YAML file: its data, and the line (counted from 1) at which each value stands."""

    path: Path
    data: Any
    lines: Mapping[Location, int]

    def place(self, location: Sequence[str | int] = ()) -> str:
        """``file:line`` of the value at `location`, or of the nearest enclosing value that is in the file."""
        known = tuple(location)
        while known and known not in self.lines:
            known = known[:-1]
        return f"{self.path}:{self.lines.get(known, 1)}"


def load(path: Path) -> Document:
    """Read one YAML document.

    Raises UnusableInputError, with file and line, on unreadable files, syntax errors and repeated keys.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UnusableInputError(path, f"cannot be read ({reason}), expected a YAML file") from error
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        raise UnusableInputError(path, f"not valid YAML: character {error.character!r} is not allowed") from error
    try:
        root = loader.get_single_node()
        lines: dict[Location, int] = {}
        if root is not None:
            _index(Path(path), root, (), lines)
        data = loader.construct_document(root) if root is not None else {}
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise UnusableInputError(f"{path}:{line}", f"not valid YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise UnusableInputError(path, f"not valid YAML: {' '.join(str(error).split())}") from error
    finally:
        loader.dispose()
    return Document(Path(path), data, lines)


def _index(path: Path, node: yaml.Node, location: Location, lines: dict[Location, int]) -> None:
    lines.setdefault(location, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            name, line = str(key.value), key.start_mark.line + 1
            if name in seen:
                raise UnusableInputError(
                    f"{path}:{line}", f"key '{name}' is repeated, first given in line {seen[name]}"
                )
            seen[name] = line
            lines[(*location, name)] = line
            _index(path, value, (*location, name), lines)
    elif isinstance(node, yaml.SequenceNode):
        for position, item in enumerate(node.value):
            _index(path, item, (*location, position), lines)


def validate(
    document: Document, model: type[Model], location: Location = (), context: Mapping[str, Any] | None = None
) -> Model:
    """Validate the data at `location` of a document against a pydantic model.

    Raises UnusableInputError that names file, line, key, what was found and what was expected (the first
    error; the number of further ones is said). `context` is handed to the model's validators.
    """
    data = document.data
    for step in location:
        data = data[step]
    try:
        return model.model_validate(data, context=dict(context or {}))
    except ValidationError as error:
        raise _unusable(document, location, error) from error


def _unusable(document: Document, location: Location, error: ValidationError) -> UnusableInputError:
    problems = error.errors()
    first = problems[0]
    where: Location = (*location, *first["loc"])
    key = ".".join(str(part) for part in first["loc"]) or "document"
    if first["type"] == "extra_forbidden":
        text = f"unknown key '{key}'"
    elif first["type"] == "missing":
        text = f"'{key}' is missing"
    else:
        message = first["msg"].removeprefix("Value error, ")
        text = f"'{key}' is {first['input']!r}, expected: {message}"
        if len(text) > 300:
            text = f"'{key}': {message}"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return UnusableInputError(document.place(where), " ".join(text.split()) + more)
