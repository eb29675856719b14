"""Config files for people and editors: commented YAML, single values changed in their text, and the JSON Schema."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel

from hilbench import strict_yaml
from hilbench.errors import UnusableInputError
from hilbench.files import written_whole
from hilbench.runs.config import ExperimentConfig, load, read_document

_COMMENT_COLUMN = 34


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a bench config file, its `include` too; nothing is required of a file that includes."""
    schema = ExperimentConfig.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "hilbench bench config"
    names = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}
    schema["properties"]["include"] = {
        **names,
        "description": "config files that this one is based on, by their path from here",
    }
    complete = {"required": schema.pop("required")}
    for block in schema["$defs"].values():
        block.pop("required", None)  # what a file includes may give it: `hilbench check` reports what is missing
    return {**_any_of(schema), "if": {"not": {"required": ["include"]}}, "then": complete}


def _any_of(node: Any) -> Any:
    """Replace `oneOf` by `anyOf`: where nothing is required a block may be one of several kinds."""
    if isinstance(node, list):
        return [_any_of(each) for each in node]
    if isinstance(node, dict):
        return {"anyOf" if key == "oneOf" else key: _any_of(each) for key, each in node.items()}
    return node


def commented_yaml(config: ExperimentConfig, folder: Path) -> str:
    """The config as YAML, every key with its description where it has one; EDS paths from `folder`."""
    return "\n".join(_lines(config, folder, 0)) + "\n"


def _lines(block: BaseModel, folder: Path, depth: int) -> Iterator[str]:
    for name, field in type(block).model_fields.items():
        value = getattr(block, name)
        if value is None:
            continue
        if isinstance(value, BaseModel):
            inner = list(_lines(value, folder, depth + 1))
            if inner:
                yield _line(depth, f"{name}:", field.description or _first_line(value))
                yield from inner
            continue
        if isinstance(value, Path):
            value = Path(os.path.relpath(value, folder))
        if value and isinstance(value, Mapping) and all(isinstance(part, BaseModel) for part in value.values()):
            yield _line(depth, f"{name}:", field.description)
            for key, part in value.items():
                yield _line(depth + 1, f"{key}:", _first_line(part))
                yield from _lines(part, folder, depth + 2)
            continue
        if value and isinstance(value, list | tuple) and isinstance(value[0], BaseModel):
            yield _line(depth, f"{name}:", field.description)
            yield from ("  " * (depth + 1) + "- " + _flow(_as_yaml(entry)) for entry in value)
            continue
        yield _line(depth, f"{name}: {_flow(_as_yaml(value))}", field.description)


def _line(depth: int, text: str, comment: str | None) -> str:
    left = "  " * depth + text
    return f"{left:<{_COMMENT_COLUMN}} # {comment}" if comment else left


def _first_line(block: BaseModel) -> str:
    return (type(block).__doc__ or "").strip().partition("\n")[0].rstrip(".")


def _as_yaml(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return _tag(value) | value.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, Mapping):
        return {key: _as_yaml(entry) for key, entry in value.items()}
    return [_as_yaml(entry) for entry in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def _tag(block: BaseModel) -> dict[str, Any]:
    """Keys that identify the kind of block: those that can have one value only, which is their default."""
    fields = type(block).model_fields
    return {
        name: getattr(block, name)
        for name, field in fields.items()
        if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1
    }


def _flow(value: Any) -> str:
    text = strict_yaml.text_of(value, default_flow_style=True, width=10_000)
    return text.removesuffix("\n").removesuffix("\n...")


def write_value(path: Path, location: Sequence[str], value: Any) -> Path:
    """Set the value at a location of a config, in that of its files in which the nearest block is given.

    A file (``eds``) is written relative to the folder of that file. Returns the file that was changed. Raises
    UnusableInputError for a file that can't be changed so, which then is as it was.
    """
    file = Path(read_document(path).place(location).rpartition(":")[0])
    if location[-1] == "eds":
        value = Path(os.path.relpath(value, file.resolve().parent)).as_posix()
    before = file.read_bytes()
    text = edited(before.decode("utf-8"), location, value, file)
    _put(file, text.encode("utf-8"))
    try:
        load(path)
    except UnusableInputError:
        _put(file, before)
        raise
    return file


def _put(file: Path, data: bytes) -> None:
    with written_whole(file) as partial:
        partial.write_bytes(data)


def edited(text: str, location: Sequence[str], value: Any, place: str | Path) -> str:
    """YAML text with another value at a location, mappings made where there are none; all else is unchanged.

    Raises UnusableInputError, at `place`, where a value on the path is no mapping.
    """
    root = yaml.compose(text, yaml.SafeLoader)
    node, done = root, 0
    while isinstance(node, yaml.MappingNode) and done < len(location):
        below = next((value for key, value in node.value if str(key.value) == location[done]), None)
        if below is None:
            break
        node, done = below, done + 1
    rest = location[done:]
    if isinstance(node, yaml.MappingNode) and rest:
        changed = _with_key(text, node, _pair(rest, value))
    elif isinstance(node, yaml.ScalarNode) and (not rest or (node.value == "" and node.style is None)):  # no value yet
        new = _scalar(value) if not rest else "{" + _pair(rest, value) + "}"
        start, end = node.start_mark.index, node.end_mark.index
        changed = text[:start] + ("" if text[start - 1 : start] in (" ", "") else " ") + new + text[end:]
    else:
        name = ".".join(location)
        raise UnusableInputError(place, f"'{name}' can't be set in it, expected mappings and a single value on the way")
    return changed


def _with_key(text: str, node: yaml.MappingNode, pair: str) -> str:
    """Mapping with a further key, after the last one that is in its line as a whole."""
    if node.flow_style:
        if not node.value:
            at = node.start_mark.index + 1
            return text[:at] + pair + text[at:]
        at = node.value[-1][1].end_mark.index
        return f"{text[:at]}, {pair}{text[at:]}"
    indent = " " * node.value[0][0].start_mark.column
    for _, value in reversed(node.value):
        in_line = isinstance(value, yaml.ScalarNode) and value.style not in ("|", ">")
        if in_line or getattr(value, "flow_style", False):
            end = text.find("\n", value.end_mark.index)
            return f"{text}\n{indent}{pair}\n" if end < 0 else f"{text[:end]}\n{indent}{pair}{text[end:]}"
    at = node.value[0][0].start_mark.index
    return f"{text[:at]}{pair}\n{indent}{text[at:]}"


def _pair(location: Sequence[str], value: Any) -> str:
    *outer, last = location
    found = f"{last}: {_scalar(value)}"
    for key in reversed(outer):
        found = f"{key}: {{{found}}}"
    return found


def _scalar(value: Any) -> str:
    """A single value as YAML; a text that could be taken for something else in quotes."""
    if isinstance(value, str):
        plain = (
            strict_yaml.parse_value(value, "a text") if value and not set(value) & set(",[]{}#:&*!|>'\"%@`") else None
        )
        return value if plain == value else "'" + value.replace("'", "''") + "'"
    return repr(value) if not isinstance(value, bool) else str(value).lower()
