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

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Values that their type cannot hold are errors of the file, with their place."""
        try:
            return super().construct_object(node, deep)
        except ValueError as error:
            raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from error

    def construct_core_int(self, node: yaml.ScalarNode) -> int:
        """A leading zero means nothing in YAML 1.2: 010 is ten."""
        text = str(self.construct_scalar(node))
        return int(text, 0 if text[:2] in ("0x", "0o") else 10)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_core_int)


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
    """Parsed YAML: its data, and where each value was given: ``file:line``, or the option of a command line."""

    path: Path
    data: Any
    places: Mapping[Location, str]

    def place(self, location: Sequence[str | int] = ()) -> str:
        """Where the value at `location`, or the nearest enclosing value that was given, stands."""
        known = tuple(location)
        while known and known not in self.places:
            known = known[:-1]
        return self.places.get(known, f"{self.path}:1")

    def with_value(self, location: Sequence[str | int], value: Any, place: str) -> Document:
        """The document with another value at `location`, given at `place`; mappings on the way are made.

        Raises UnusableInputError, at `place`, for a position that a list does not have, or a value that holds none.
        """
        where = tuple(location)
        data = _with_value(self.data, where, value, place, where)
        return Document(self.path, data, _without(self.places, where) | {where: place})

    def over(self, base: Document) -> Document:
        """This document on top of another: mappings key by key, everything else of this one instead of the other's."""
        places = dict(base.places)
        for location in _replaced(self.data, base.data):
            places = _without(places, location)
        return Document(self.path, _merged(self.data, base.data), places | dict(self.places))

    def without(self, key: str) -> Document:
        """The document without a key of its root."""
        return Document(
            self.path, {name: self.data[name] for name in self.data if name != key}, _without(self.places, (key,))
        )


def _with_value(data: Any, rest: Location, value: Any, place: str, whole: Location) -> Any:
    if not rest:
        return value
    key, name = rest[0], ".".join(map(str, whole))
    if isinstance(data, Sequence) and not isinstance(data, str):
        if not isinstance(key, int) or not 0 <= key < len(data):
            raise UnusableInputError(
                place, f"'{name}': '{key}' in a list, expected a position from 0 to {len(data) - 1}"
            )
        return [_with_value(item, rest[1:], value, place, whole) if at == key else item for at, item in enumerate(data)]
    if data is not None and not isinstance(data, Mapping):
        raise UnusableInputError(place, f"'{name}': '{key}' of {data!r}, expected a key that exists")
    return {**(data or {}), key: _with_value((data or {}).get(key), rest[1:], value, place, whole)}


def _without(places: Mapping[Location, str], location: Location) -> dict[Location, str]:
    return {known: place for known, place in places.items() if known[: len(location)] != location}


def _merged(top: Any, base: Any) -> Any:
    if not (isinstance(top, Mapping) and isinstance(base, Mapping)):
        return top
    return {**base, **{key: _merged(value, base.get(key)) for key, value in top.items()}}


def _replaced(top: Any, base: Any, location: Location = ()) -> list[Location]:
    """Where a merge takes the whole value of `top`."""
    if not (isinstance(top, Mapping) and isinstance(base, Mapping)):
        return [location]
    return [found for key, value in top.items() for found in _replaced(value, base.get(key), (*location, key))]


def parse_value(text: str, place: str) -> Any:
    """One value as a config file would hold it: ``10.5e9``, ``true``, ``[1, 2]``. Raises UnusableInputError."""
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    except (yaml.YAMLError, RecursionError) as error:
        raise UnusableInputError(place, f"{text!r} is no YAML value ({' '.join(str(error).split())})") from error
    finally:
        loader.dispose()


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
        places: dict[Location, str] = {}
        if root is not None:
            _index(Path(path), root, (), places)
        data = loader.construct_document(root) if root is not None else {}
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise UnusableInputError(f"{path}:{line}", f"not valid YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise UnusableInputError(path, f"not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise UnusableInputError(path, "blocks are nested too deeply to be read, expected a config") from error
    finally:
        loader.dispose()
    return Document(Path(path), data, places)


def _index(path: Path, node: yaml.Node, location: Location, places: dict[Location, str]) -> None:
    places.setdefault(location, f"{path}:{node.start_mark.line + 1}")
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            name, line = str(key.value), key.start_mark.line + 1
            if name in seen:
                raise UnusableInputError(
                    f"{path}:{line}", f"key '{name}' is repeated, first given in line {seen[name]}"
                )
            seen[name] = line
            places[(*location, name)] = f"{path}:{line}"
            _index(path, value, (*location, name), places)
    elif isinstance(node, yaml.SequenceNode):
        for position, item in enumerate(node.value):
            _index(path, item, (*location, position), places)


def validate(document: Document, model: type[Model], location: Location = ()) -> Model:
    """Validate the data at `location` of a document against a pydantic model.

    Raises UnusableInputError that names file, line, key, what was found and what was expected (the first
    error; the number of further ones is said).
    """
    data = document.data
    for step in location:
        data = data[step]
    try:
        return model.model_validate(data)
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
