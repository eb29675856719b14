"""YAML for config files: repeated keys refused, ``1e-3`` a number, every value with its line.

PyYAML by default keeps the last of two equal keys and reads ``1e-3`` as a string (it follows YAML 1.1,
whose floats need a dot and a signed exponent); ``yes``/``no``/``on``/``off`` are strings here, as in YAML 1.2.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from hilbench.did_you_mean import did_you_mean
from hilbench.errors import UnusableInputError, one_line
from hilbench.files import content, usable
from hilbench.pydantic_messages import expected

Location = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

#: Bytes of a file, values in a document, those behind aliases counted each time, and digits of a whole number, at most.
_MOST_BYTES, _MOST_VALUES, _MOST_DIGITS = 1_000_000, 10_000, 1000
#: How the place of a value begins that an option of the command line has given.
_OPTION = "--"
#: Characters beyond which an error does not repeat the value that was found.
_LONGEST_TEXT = 400
#: So many keys of one name elsewhere in a config are worth a question.
_MOST_ELSEWHERE = 3


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
        if len(text) > _MOST_DIGITS:
            raise ValueError(f"a number of {len(text)} digits, expected {_MOST_DIGITS} at most")
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


if yaml.__with_libyaml__:

    class _QuickLoader(yaml.CSafeLoader, _Loader):
        """Loader with libyaml's scanner and parser, in a fifth of the time: every process of a bench reads a config.

        Blocks are composed in Python: libyaml recurses as deep as they are nested, and its stack may not suffice.
        """

        get_single_node = yaml.composer.Composer.get_single_node

        def __init__(self, text: str) -> None:
            yaml.CSafeLoader.__init__(self, text)
            yaml.composer.Composer.__init__(self)

else:
    _QuickLoader = _Loader  # type: ignore[assignment,misc]


#: libyaml's where it is there: the same text in a quarter of the time.
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def text_of(data: Any, **style: Any) -> str:
    """YAML text of data, keys in their order; `style`: further arguments of `yaml.dump`."""
    return str(yaml.dump(data, Dumper=_DUMPER, sort_keys=False, allow_unicode=True, **style))


@dataclass(frozen=True)
class Document:
    """Parsed YAML: its data, and where each value was given: ``file:line``, or the option of a command line."""

    path: Path
    data: Any
    places: Mapping[Location, str]

    def place(self, location: Sequence[str | int] = ()) -> str:
        """File and line of the value at `location`, or of the nearest enclosing value that was given; for a block also
        the options of the command line that changed something in it."""
        known = tuple(location)
        while known and known not in self.places:
            made = [option for where, option in self.places.items() if where[: len(known)] == known]
            if made:  # a block that is only there by these options
                return ", ".join(dict.fromkeys(made))
            known = known[:-1]
        place = self.places.get(known, f"{self.path}:1")
        inside = [
            option
            for where, option in self.places.items()
            if option.startswith(_OPTION) and where != known and where[: len(location)] == tuple(location)
        ]
        return f"{', '.join(inside)} in {place}" if inside and not place.startswith(_OPTION) else place

    def given(self, location: Sequence[str | int]) -> Location:
        """`location` as far as the document has values: a union's alternatives, say, are in no file."""
        found: list[str | int] = []
        data = self.data
        for step in location:
            inside = dict(enumerate(data)) if isinstance(data, list) else data
            if not isinstance(inside, Mapping) or step not in inside:
                break
            data = inside[step]
            found.append(step)
        return tuple(found)

    def value(self, location: Sequence[str | int]) -> Any:
        """The value at a location. Raises KeyError or IndexError where there is none."""
        data = self.data
        for step in location:
            data = data[step]
        return data

    def with_value(self, location: Sequence[str | int], value: Any, place: str) -> Document:
        """The document with another value at `location`, given at `place`; mappings on the way are made.

        Raises UnusableInputError, at `place`, for a position that a list does not have, or a value that holds none.
        """
        where = tuple(location)
        data = _with_value(self.data, where, value, place, where)
        return Document(self.path, data, _without(self.places, where) | {where: place})

    def over(self, base: Document) -> Document:
        """This document on top of another: mappings key by key, everything else of this one instead of the other's."""
        gone = set(_replaced(self.data, base.data))
        kept = {
            known: place
            for known, place in base.places.items()
            if not any(known[:length] in gone for length in range(len(known) + 1))
        }
        return Document(self.path, _merged(self.data, base.data), kept | dict(self.places))

    def below(self, key: str) -> Document:
        """The document as the value of one key of a new one."""
        return Document(self.path, {key: self.data}, {(key, *where): place for where, place in self.places.items()})

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
    """Locations at which a merge takes the whole value of `top`."""
    if not (isinstance(top, Mapping) and isinstance(base, Mapping)):
        return [location]
    return [found for key, value in top.items() for found in _replaced(value, base.get(key), (*location, key))]


def parse_value(text: str, place: str) -> Any:
    """One value as a config file would hold it: ``10.5e9``, ``true``, ``[1, 2]``. Raises UnusableInputError."""
    try:
        loader, root = _composed(text)
        return None if root is None else loader.construct_document(root)
    except (yaml.YAMLError, RecursionError) as error:
        raise UnusableInputError(place, f"{text!r} is no YAML value ({one_line(error)})") from error


def _composed(text: str) -> tuple[_Loader, yaml.Node | None]:
    """Loader of a text, and its root; None: the text is empty. PyYAML's own parser has better error messages."""
    try:
        loader: _Loader = _QuickLoader(text)
        return loader, loader.get_single_node()
    except (yaml.YAMLError, UnicodeEncodeError):
        loader = _Loader(text)
        return loader, loader.get_single_node()


def load(path: Path) -> Document:
    """Read one YAML document.

    Raises UnusableInputError, with file and line, on unreadable files, syntax errors and repeated keys.
    """
    with usable(path, "read", "a YAML file"):
        text = content(path, _MOST_BYTES).decode("utf-8")
    try:
        loader, root = _composed(text)
        places: dict[Location, str] = {}
        if root is not None:
            _index(Path(path), root, (), places)
        data = loader.construct_document(root) if root is not None else {}
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise UnusableInputError(f"{path}:{line}", f"not valid YAML: {error.problem}") from error
    except yaml.reader.ReaderError as error:
        raise UnusableInputError(path, f"not valid YAML: character {error.character!r} is not allowed") from error
    except yaml.YAMLError as error:
        raise UnusableInputError(path, f"not valid YAML: {one_line(error)}") from error
    except RecursionError as error:
        raise UnusableInputError(path, "blocks are nested too deeply to be read, expected a config") from error
    return Document(Path(path), data, places)


def _index(path: Path, node: yaml.Node, location: Location, places: dict[Location, str]) -> None:
    if len(places) >= _MOST_VALUES:
        raise UnusableInputError(
            f"{path}:{node.start_mark.line + 1}",
            f"more than {_MOST_VALUES} values, those behind aliases counted each time, expected fewer",
        )
    places.setdefault(location, f"{path}:{node.start_mark.line + 1}")
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise UnusableInputError(f"{path}:{line}", "a list or mapping as a key, expected a name")
            name = str(key.value)
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

    Raises UnusableInputError that names file, line, key, what was found and what was expected: all that is wrong, in
    the order in which it was given (see `UnusableInputError.of`).
    """
    try:
        return model.model_validate(document.value(location))
    except ValidationError as error:
        raise UnusableInputError.of(_problems(document, location, model, error)) from error


def _problems(
    document: Document, location: Location, model: type[BaseModel], error: ValidationError
) -> list[UnusableInputError]:
    """Problems, one for each wrong value; the kinds of value that a key may have (a union) are one expectation."""
    by_value: dict[Location, list[ErrorDetails]] = {}
    for details in error.errors():
        if details["type"] == "default_factory_not_called":
            continue  # follows from what is wrong with the keys that the default is made of
        where = (*location, *_without_alternatives(model, details["loc"]))
        missing = details["type"] in ("missing", "extra_forbidden")
        by_value.setdefault(where if missing else document.given(where), []).append(details)
    problems = [
        UnusableInputError(document.place(where), _text(where[len(location) :], model, found))
        for where, found in by_value.items()
    ]
    return sorted(problems, key=_line)


def _without_alternatives(model: type[BaseModel], loc: Location) -> Location:
    """Location without the steps that name an alternative of a union of blocks: those are in no file."""
    found: list[str | int] = []
    for at, step in enumerate(loc):
        blocks = _blocks(model, found)
        is_key = any(step in block.model_fields for block in blocks)
        if len(blocks) > 1 and not is_key and at + 1 < len(loc):
            continue
        found.append(step)
    return tuple(found)


def _line(problem: UnusableInputError) -> tuple[str, int]:
    """Sort key: the file of a place and its line; options of the command line come first."""
    file, _, line = problem.place.rpartition(":")
    return (file, int(line)) if line.isdecimal() else ("", 0)


def _text(loc: Location, model: type[BaseModel], found: Sequence[ErrorDetails]) -> str:
    key, first = ".".join(map(str, loc)) or "document", found[0]
    if first["type"] == "extra_forbidden":
        return f"unknown key '{key}'{_instead(loc, model)}"
    if first["type"] == "missing":
        return f"'{key}' is missing"
    message = ", or ".join(dict.fromkeys(map(expected, found)))
    if first["type"] == "value_error" and isinstance(first["input"], dict):  # a block: the message names the part
        message = message if "expected" in message.lower() else f"expected {message}"
        return f"'{key}': {message}" if loc else message
    text = f"'{key}' is {first['input']!r}, expected: {message}"
    return text if len(text) <= _LONGEST_TEXT else f"'{key}': expected: {message}"


def _instead(loc: Location, model: type[BaseModel]) -> str:
    """Suggestion for an unknown key: a key of its block, or one of that name elsewhere."""
    *block, name = map(str, loc)
    beside = {known for known_block in _blocks(model, loc[:-1]) for known in known_block.model_fields}
    if found := did_you_mean(name, beside):
        return found.replace("'", "'" + "".join(f"{key}." for key in block), 1)
    elsewhere = [path for path in dict.fromkeys(_paths(model)) if path.rpartition(".")[2].lower() == name.lower()]
    paths = " or ".join(f"'{path}'" for path in elsewhere)
    return f", did you mean {paths}?" if 0 < len(elsewhere) <= _MOST_ELSEWHERE else ""


def _blocks(model: type[BaseModel], location: Sequence[str | int]) -> list[type[BaseModel]]:
    """The models that the value at a location may be."""
    kinds: list[Any] = [model]
    for step in location:
        inner: list[Any] = []
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                if step in kind.model_fields:
                    inner += _kinds(kind.model_fields[str(step)].annotation)
            elif get_origin(kind) is not None:  # of a list or mapping: what it holds
                inner += _kinds(get_args(kind)[-1])
        kinds = inner
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _kinds(annotation: Any) -> list[Any]:
    """Alternatives of a type; an annotated type counts without its annotations."""
    if get_origin(annotation) is Annotated:
        return _kinds(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [kind for part in get_args(annotation) for kind in _kinds(part)]
    return [annotation]


def _paths(model: type[BaseModel]) -> Iterator[str]:
    """Every key below a model, dotted; not those in lists and mappings, which have no name of their own."""
    for name, field in model.model_fields.items():
        yield name
        for kind in _kinds(field.annotation):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from (f"{name}.{path}" for path in _paths(kind))
