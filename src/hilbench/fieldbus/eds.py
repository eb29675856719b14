"""EDS and DCF files (CiA 306) into object dictionaries, tolerant of what real files contain.

canopen's importer does the work; fields it cannot digest although they are harmless (empty ones, mostly) are taken
out beforehand, and everything else that is wrong is reported with file and line.
"""

from __future__ import annotations

import configparser
import io
import re
from pathlib import Path
from typing import Any

import canopen
from canopen import objectdictionary
from canopen.objectdictionary import ODVariable

from hilbench.errors import UnusableInputError

_SECTION = re.compile(r"^\[([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?\]\s*$")
_KEY = re.compile(r"^([A-Za-z0-9_ ]+?)\s*=(.*)$")
_MAY_BE_EMPTY = ("parametername", "denotation")


def load_eds(path: Path, node_id: int) -> canopen.ObjectDictionary:
    """The object dictionary in an EDS or DCF file, ``$NODEID`` filled in.

    Raises UnusableInputError with file and line when the file cannot be read or is no EDS.
    """
    try:
        text = Path(path).read_text(encoding="latin-1")
    except OSError as error:
        raise UnusableInputError(path, f"cannot be read ({error.strerror}), expected an EDS or DCF file") from error
    _check_syntax(Path(path), text)
    source = io.StringIO(_without_empty_fields(text))
    source.name = str(path)
    try:
        od = canopen.import_od(source, node_id)
    except Exception as error:  # the importer lets whatever int() and configparser raise come through
        place = _blame(Path(path), text, node_id)
        raise UnusableInputError(place, f"not usable as an EDS: {' '.join(str(error).split())}") from error
    if not len(od):
        raise UnusableInputError(path, "no objects in it, expected an EDS or DCF file")
    od.node_id = node_id
    return od


def _check_syntax(path: Path, text: str) -> None:
    section_seen = False
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if not stripped or stripped[0] in ";#":
            continue
        if stripped.startswith("[") and stripped.endswith("]"):
            section_seen = True
        elif not section_seen or "=" not in stripped:
            raise UnusableInputError(f"{path}:{number}", f"found {stripped[:40]!r}, expected [section] or key=value")
    if not section_seen:
        raise UnusableInputError(path, "no sections in it, expected an EDS or DCF file")


def _without_empty_fields(text: str) -> str:
    kept = []
    for line in text.splitlines():
        match = _KEY.match(line.strip())
        if match and not match.group(2).strip() and match.group(1).strip().lower() not in _MAY_BE_EMPTY:
            continue
        kept.append(line)
    return "\n".join(kept) + "\n"


def _blame(path: Path, text: str, node_id: int) -> str:
    """``file:line`` of the first object section that cannot be imported by itself, else the file."""
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        if not _SECTION.match(line.strip()):
            continue
        end = next((k for k in range(number, len(lines)) if lines[k].strip().startswith("[")), len(lines))
        block = "\n".join(lines[number - 1 : end])
        parser = configparser.RawConfigParser(strict=False, interpolation=None)
        try:
            parser.read_string(_without_empty_fields(block))
            for key in ("datatype", "subnumber", "objecttype"):
                value = parser[parser.sections()[0]].get(key)
                if value is not None:
                    int(value, 0)
        except (configparser.Error, ValueError):
            return f"{path}:{number}"
    return str(path)


def find(od: canopen.ObjectDictionary, key: int | str) -> ODVariable:
    """One variable: by index, by ``0x6403sub1``, or by its name in snake case (``target_velocity``).

    A record or array needs the sub-index. Raises KeyError when the dictionary has no such variable.
    """
    if isinstance(key, str):
        match = re.fullmatch(r"(0x[0-9a-fA-F]+)(?:sub([0-9a-fA-F]+))?", key)
        if match:
            return variable(od, int(match.group(1), 16), int(match.group(2) or "0", 16))
        return _by_name(od, key)
    return variable(od, key, 0)


def variable(od: canopen.ObjectDictionary, index: int, sub: int) -> ODVariable:
    """The variable at index and sub-index. Raises KeyError."""
    obj = od[index]
    if isinstance(obj, ODVariable):
        if sub:
            raise KeyError(f"{index:04X}h has no sub-index {sub}")
        return obj
    if isinstance(obj, objectdictionary.ODArray) and sub not in obj.subindices:
        raise KeyError(f"{index:04X}h has no sub-index {sub}")
    found: ODVariable = obj[sub]
    return found


def snake_case(name: str) -> str:
    """``Target velocity`` → ``target_velocity``."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _by_name(od: canopen.ObjectDictionary, name: str) -> ODVariable:
    for obj in od.values():
        if isinstance(obj, ODVariable) and snake_case(obj.name) == name:
            return obj
    raise KeyError(f"no object named '{name}'")


def all_variables(od: canopen.ObjectDictionary) -> list[ODVariable]:
    """Every variable of the dictionary, entries of records and arrays included."""
    found: list[Any] = []
    for obj in od.values():
        found += [obj] if isinstance(obj, ODVariable) else list(obj.subindices.values())
    return found
