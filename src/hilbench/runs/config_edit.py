"""Edits of single values of a config file as text, so that comments and layout stay as written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from hilbench import strict_yaml
from hilbench.errors import UnusableInputError
from hilbench.files import written_whole


def write_value(path: Path, location: Sequence[str], value: Any) -> Path:
    """Set the value at a location of a config, in that of its files in which the nearest block is given.

    A file (``eds``) is written relative to the folder of that file. Returns the file that was changed. Raises
    UnusableInputError for a file that can't be changed so, which then is as it was.
    """
    from hilbench.runs.config import load, read_document

    file = Path(read_document(path).place(location).rpartition(":")[0])
    if location[-1] == "eds":
        value = Path(os.path.relpath(value, file.resolve().parent)).as_posix()
    before = file.read_bytes()
    text = edited(before.decode("utf-8"), location, value, file)
    _write(file, text.encode("utf-8"))
    try:
        load(path)
    except UnusableInputError:
        _write(file, before)
        raise
    return file


def _write(file: Path, data: bytes) -> None:
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
    elif isinstance(node, yaml.ScalarNode) and (not rest or _is_nothing(node)):
        new = _flow(value) if not rest else "{" + _pair(rest, value) + "}"
        start, end = node.start_mark.index, node.end_mark.index
        changed = text[:start] + ("" if text[start - 1 : start] in (" ", "") else " ") + new + text[end:]
    else:
        name = ".".join(location)
        raise UnusableInputError(place, f"'{name}' can't be set in it, expected mappings and a single value on the way")
    return changed


def _is_nothing(node: yaml.ScalarNode) -> bool:
    """True if a key has no value at all: an empty text in quotes is one."""
    return node.value == "" and node.style is None


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
    found = f"{last}: {_flow(value)}"
    for key in reversed(outer):
        found = f"{key}: {{{found}}}"
    return found


def _flow(value: Any) -> str:
    """A single value as YAML; a text that could be taken for something else in quotes."""
    if isinstance(value, str):
        plain = (
            strict_yaml.parse_value(value, "a text") if value and not set(value) & set(",[]{}#:&*!|>'\"%@`") else None
        )
        return value if plain == value else "'" + value.replace("'", "''") + "'"
    return repr(value) if not isinstance(value, bool) else str(value).lower()
