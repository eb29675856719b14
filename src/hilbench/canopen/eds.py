"""EDS and DCF files (CiA 306) as canopen's object dictionary, read with their line numbers.

canopen's own reader skips values it can't convert; here they are refused, and fields that makers leave empty tolerated.
"""

from __future__ import annotations

import pickle
import re
from collections.abc import Container
from copy import copy
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from canopen.objectdictionary import ODArray, ODRecord, ODVariable

import canopen
from hilbench.canopen.data_types import NODE_ID, DataType, Value, data_type
from hilbench.canopen.identifiers import MAPPING, pdo_name
from hilbench.errors import UnusableInputError
from hilbench.files import content, require_file, usable

#: Bytes of a file, objects in it with their entries, and the last sub-index there is (CiA 301).
MOST_BYTES, _MOST_OBJECTS, _LAST_SUB = 4_000_000, 65_536, 254
#: Below it are data types; 0001h to 0007h may be mapped as placeholders.
_FIRST_OBJECT = 0x1000
_FIRST_OF_MAKERS = 0x2000
_VAR = 0x7
_ARRAY = 0x8
_ARRAY_TYPES = (_ARRAY, 0x9)  # ObjectType ARRAY, RECORD
_DOMAIN = 0x2
_DEFTYPE = 0x5
_NO_VALUE = (0x0, _DEFTYPE, 0x6)  # ObjectType NULL, DEFTYPE, DEFSTRUCT: nothing to read or write
#: Data types of a length in bits, in the place of a maker's own that are only defined by it.
_OF_LENGTH = {each.pdo_bits: each for each in DataType if each.kind == "unsigned"}
_ACCESS_TYPES = {"ro", "wo", "rw", "rwr", "rww", "const"}
_OBJECT = re.compile(r"^([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?$", re.IGNORECASE)
_INDEX_KEY = re.compile(r"^(?:0x)?([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?$", re.IGNORECASE)
_KEYS = {
    name.lower(): name
    for name in (
        "ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "ParameterValue", "LowLimit",
        "HighLimit", "PDOMapping", "CompactSubObj", "ObjFlags", "VendorNumber", "ProductNumber", "RevisionNumber",
    )
}  # fmt: skip


@dataclass
class _Section:
    name: str
    line: int
    options: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)


#: Sections by index and sub-index; None: of the object itself.
_Objects = dict[tuple[int, int | None], _Section]


def load_eds(path: Path | str, node_id: int) -> canopen.ObjectDictionary:
    """Object dictionary of an EDS or DCF file for the device with this node id (``$NODEID`` is resolved).

    Raises UnusableInputError with file and line when the file cannot be read or an object in it is not usable:
    no name, type or access type, a value of CiA 301's objects or of a DCF that is none of its type, a sub-index without
    its object. Other odd defaults and limits are left out, and stand in the variable's `description`.
    """
    path = Path(path)
    return _of_node(path, node_id, _as_of(path))


def shared_eds(path: Path | str, node_id: int) -> canopen.ObjectDictionary:
    """Load an EDS file once and share it, not to be changed, as long as the file stays as it is: at its start
    a bench needs each file many times. Raises UnusableInputError as `load_eds`.
    """
    path = Path(path)
    return _shared(path, node_id, _as_of(path))


def _of_node(path: Path, node_id: int, as_of: tuple[int, int]) -> canopen.ObjectDictionary:
    template, of_nodes = _of_any_node(path, as_of)
    own: canopen.ObjectDictionary = pickle.loads(template)
    own.node_id = node_id
    for (index, sub), section in of_nodes.items():
        _take_values(path, section, variable(own, index, sub or 0), node_id)
    return own


_shared = lru_cache(64)(_of_node)


@lru_cache(16)  # nodes of one kind share their file; to unpickle takes a fifth of the time to copy
def _of_any_node(path: Path, as_of: tuple[int, int]) -> tuple[bytes, _Objects]:
    """The dictionary, pickled, and what in it depends on the node id."""
    sections = _sections(path, as_of)
    objects = _object_sections(path, sections)
    _check_hierarchy(path, objects)
    of_nodes = {key: section for key, section in objects.items() if _depends_on_node(path, section)}
    return pickle.dumps(_read(path, sections, objects)), of_nodes


def _depends_on_node(path: Path, section: _Section) -> bool:
    """True if it is a variable with a value that depends on the node id."""
    is_variable = _integer(path, section, "ObjectType", _VAR) not in _ARRAY_TYPES
    return is_variable and any(NODE_ID in section.options.get(key, "").upper() for key in _VALUES)


def _as_of(path: Path) -> tuple[int, int]:
    """Modification time and size of a file, to detect a change."""
    require_file(path)
    with usable(path, "read", "an EDS file"):
        status = path.stat()
    return status.st_mtime_ns, status.st_size


def object_flags(path: Path) -> dict[tuple[int, int], int]:
    """ObjFlags (CiA 306, 4.6.3.2) by index and sub-index, of the values that have some.

    Raises UnusableInputError as `load_eds` does.
    """
    objects = _object_sections(path, _sections(path, _as_of(path)))
    flags = {key: _integer(path, section, "ObjFlags", 0) for key, section in objects.items()}
    return {(index, sub or 0): value for (index, sub), value in flags.items() if value}


def option(path: Path, section: str, key: str) -> str:
    """Text of a key in a section of a file, both in any case; "" without it. Raises UnusableInputError."""
    found = _sections(path, _as_of(path)).get(section.lower())
    options = {} if found is None else {name.lower(): text for name, text in found.options.items()}
    return options.get(key.lower(), "")


def require_integers(od: canopen.ObjectDictionary, indices: Container[int]) -> None:
    """Raise UnusableInputError for the first of these objects that is something else in the file."""
    for found in all_variables(od):
        code = found.data_type or 0
        if found.index in indices and not data_type(code).is_integer:
            what = f"{found.index:04X}h sub {found.subindex} '{found.name}' is of data type {code:04X}h"
            raise UnusableInputError(f"EDS of node {od.node_id}", f"{what}, expected an integer")


def _read(path: Path, sections: dict[str, _Section], objects: _Objects) -> canopen.ObjectDictionary:
    """The dictionary of a node without an id; of `objects` the hierarchy has been checked."""
    od = canopen.ObjectDictionary()
    _fill_device_information(path, sections, od)
    for (index, sub), section in objects.items():
        kind = _integer(path, section, "ObjectType", _VAR)
        if sub is None and kind in _ARRAY_TYPES:
            od.add_object((ODArray if kind == _ARRAY else ODRecord)(section.options["ParameterName"], index))
        elif sub is None:
            od.add_object(_variable_of(path, section, index, 0))
        else:
            parent = od[index]
            assert not isinstance(parent, ODVariable), "its hierarchy has been checked"
            parent.add_member(_variable_of(path, section, index, sub))
    return od


def find(od: canopen.ObjectDictionary, key: int | str) -> ODVariable:
    """One variable: by index, by ``0x6403sub1``, or by its parameter name in snake case (``target_velocity``; an
    entry of a record as ``identity_object.vendor_id``).

    A record or array needs the sub-index. Raises KeyError, with a text for a person, when the dictionary has no such
    variable or several of that name.
    """
    if isinstance(key, int):
        return variable(od, key, 0)
    match = _INDEX_KEY.match(key.strip())
    if match:
        return variable(od, int(match[1], 16), int(match[2] or "0", 16))
    return _find_by_name(od, key)


def variable(od: canopen.ObjectDictionary, index: int, sub: int) -> ODVariable:
    """The variable at index and sub-index. Raises KeyError."""
    found = known(od, index, sub)
    if found is None:
        raise KeyError(f"{index:04X}h has no sub-index {sub}" if index in od.indices else f"no object {index:04X}h")
    return found


def known(od: canopen.ObjectDictionary, index: int, sub: int) -> ODVariable | None:
    """The variable at index and sub-index; None: there is none."""
    entry = od.indices.get(index)
    if entry is None or isinstance(entry, ODVariable):
        return entry if sub == 0 else None
    # canopen's arrays invent members on access; only those of the file count.
    found: ODVariable | None = entry.subindices.get(sub)
    return found


def all_variables(od: canopen.ObjectDictionary) -> list[ODVariable]:
    """Every variable of the dictionary, entries of records and arrays included, dummy types (below 1000h) excluded."""
    found: list[ODVariable] = []
    for index in sorted(od.indices):
        entry = od.indices[index]
        if isinstance(entry, ODVariable):
            found += [entry] if index >= _FIRST_OBJECT else []
        else:
            found += [entry.subindices[sub] for sub in sorted(entry.subindices)]
    return found


def with_mapped_pdos(od: canopen.ObjectDictionary) -> canopen.ObjectDictionary:
    """Without the communication parameters of PDOs that have no mapping, which canopen would ask for."""
    mapped = copy(od)
    mapped.indices = {
        index: entry for index, entry in od.indices.items() if not pdo_name(index) or index + MAPPING in od.indices
    }
    return mapped


def snake_case(name: str) -> str:
    """``Target velocity`` → ``target_velocity``."""
    return re.sub(r"[^0-9a-z]+", "_", name.lower()).strip("_")


def _find_by_name(od: canopen.ObjectDictionary, name: str) -> ODVariable:
    found = [candidate for candidate in all_variables(od) if _full_name(candidate) == name]
    if len(found) == 1:
        return found[0]
    if not found:
        raise KeyError(f"no object named '{name}'")
    where = ", ".join(f"0x{candidate.index:04X}sub{candidate.subindex:X}" for candidate in found)
    raise KeyError(f"'{name}' names several objects: {where}")


def _full_name(candidate: ODVariable) -> str:
    parent: object = candidate.parent
    own = snake_case(candidate.name)
    return f"{snake_case(parent.name)}.{own}" if isinstance(parent, ODRecord | ODArray) else own


@lru_cache(16)
def _sections(path: Path, _as_of: tuple[int, int]) -> dict[str, _Section]:
    with usable(path, "read", "an EDS file"):
        text = content(path, MOST_BYTES).decode("utf-8-sig", errors="replace")
    sections: dict[str, _Section] = {}
    current: _Section | None = None
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if not line or line[0] in ";#":
            continue
        if line.startswith("[") and "]" in line:
            current = _Section(line[1 : line.index("]")].strip(), number)
            known = sections.setdefault(current.name.lower(), current)
            if known is not current:
                raise UnusableInputError(
                    f"{path}:{number}", f"section [{current.name}] is repeated, first given in line {known.line}"
                )
        elif current is None or "=" not in line:
            raise UnusableInputError(f"{path}:{number}", f"'{line[:40]}' found, expected [section] or key=value")
        else:
            _add_option(path, current, line, number)
    return sections


def _add_option(path: Path, section: _Section, line: str, number: int) -> None:
    key, value = (part.strip() for part in line.split("=", 1))
    key = _KEYS.get(key.lower(), key)
    if ";" in value:
        value = re.split(r"\s;", value, maxsplit=1)[0].strip()
    if key in section.options:
        raise UnusableInputError(
            f"{path}:{number}", f"key '{key}' is repeated, first given in line {section.lines[key]}"
        )
    if value and not value.startswith(";"):  # an empty field gives no value
        section.options[key] = value
        section.lines[key] = number


def _object_sections(path: Path, sections: dict[str, _Section]) -> _Objects:
    objects: _Objects = {}
    for section in sections.values():
        match = _OBJECT.match(section.name)
        if match:
            index = int(match[1], 16)
            objects[(index, int(match[2], 16) if match[2] else None)] = section
    types = _defined_types(path, objects)
    for (index, sub), section in list(objects.items()):
        if sub is None and _integer(path, section, "ObjectType", _VAR) in _NO_VALUE:
            for key in [key for key in objects if key[0] == index]:
                del objects[key]
    if not objects:
        raise UnusableInputError(path, "no object is in the file, expected an EDS file (CiA 306)")
    for (index, sub), section in list(objects.items()):
        if sub is None and "CompactSubObj" in section.options:
            objects.update(_expand_compact(path, index, section, sections))
            if len(objects) > _MOST_OBJECTS:
                raise UnusableInputError(path, f"more than {_MOST_OBJECTS} objects and entries, expected fewer")
    for section in objects.values():
        defined = types.get(_integer(path, section, "DataType", 0)) if types else None
        if defined is not None:
            section.options["DataType"] = defined
    objects.update(_dummies(sections.get("dummyusage")))
    return dict(sorted(objects.items(), key=lambda item: (item[0][0], -1 if item[0][1] is None else item[0][1])))


def _defined_types(path: Path, objects: _Objects) -> dict[int, str]:
    """DEFTYPE objects (CiA 301, 7.4.1): the basic type of each by its DataType, or by the length in bits that an
    UNSIGNED32 has as its default."""
    types = {}
    for (index, sub), section in objects.items():
        if sub is None and _integer(path, section, "ObjectType", _VAR) == _DEFTYPE:
            code = _integer(path, section, "DataType", 0)
            if code == DataType.UNSIGNED32:
                code = _OF_LENGTH.get(_integer(path, section, "DefaultValue", 0), 0)
            if code:
                types[index] = str(code)
    return types


def _expand_compact(path: Path, index: int, section: _Section, sections: dict[str, _Section]) -> _Objects:
    """Sub-indices given by CompactSubObj (CiA 306, 4.6.3.3), named and valued by their own sections."""
    count = _integer(path, section, "CompactSubObj", 0)
    if not 0 <= count <= _LAST_SUB:
        raise UnusableInputError(
            f"{path}:{section.lines['CompactSubObj']}",
            f"CompactSubObj of [{section.name}] is {count}, expected 0 to {_LAST_SUB}",
        )
    names, values = (sections.get(f"{section.name}{what}".lower()) for what in ("Name", "Value"))
    members: _Objects = {}
    head = {"ParameterName": "Number of entries", "DataType": "0x5", "AccessType": "ro", "DefaultValue": str(count)}
    members[(index, 0)] = _Section(f"{section.name}sub0", section.line, head)
    shared = {key: section.options[key] for key in section.options if key not in ("CompactSubObj", "ObjectType")}
    for sub in range(1, count + 1):
        options = dict(shared)
        options["ParameterName"] = f"{shared.get('ParameterName', '')} {sub}".strip()
        if names and str(sub) in names.options:
            options["ParameterName"] = names.options[str(sub)]
        if values and str(sub) in values.options:
            options["ParameterValue"] = values.options[str(sub)]
        members[(index, sub)] = _Section(f"{section.name}sub{sub:X}", section.line, options, section.lines)
    array = {"ParameterName": section.options.get("ParameterName", section.name), "ObjectType": "0x8"}
    members[(index, None)] = _Section(section.name, section.line, array, section.lines)
    return members


def _dummies(usage: _Section | None) -> _Objects:
    """Data types that may be mapped as placeholders, as objects 0001h to 0007h."""
    if usage is None:
        return {}
    return {
        (code, None): _Section(
            f"{code:04X}",
            usage.line,
            {"ParameterName": f"Dummy{code:04d}", "DataType": str(code), "AccessType": "wo", "PDOMapping": "1"},
        )
        for code in range(1, 8)
        if usage.options.get(f"Dummy{code:04d}") == "1"
    }


def _check_hierarchy(path: Path, objects: _Objects) -> None:
    for (index, sub), section in objects.items():
        place = f"{path}:{section.line}"
        if sub is not None:
            parent = objects.get((index, None))
            if parent is None or _integer(path, parent, "ObjectType", _VAR) not in _ARRAY_TYPES:
                raise UnusableInputError(place, f"[{section.name}] has no array or record [{index:04X}] it belongs to")
        kind = _integer(path, section, "ObjectType", _VAR)
        if kind not in (_VAR, _DOMAIN) and (sub is not None or kind not in _ARRAY_TYPES):
            line = section.lines.get("ObjectType", section.line)
            raise UnusableInputError(
                f"{path}:{line}", f"ObjectType of [{section.name}] is {kind}, expected 2, 7, 8 or 9 (CiA 306)"
            )
        if "ParameterName" not in section.options:
            raise UnusableInputError(place, f"[{section.name}] has no ParameterName")
        if kind in _ARRAY_TYPES:
            continue
        for key in ("DataType", "AccessType"):
            if key not in section.options:
                raise UnusableInputError(place, f"[{section.name}] has no {key}")
        access = section.options["AccessType"]
        if access.lower() not in _ACCESS_TYPES:
            raise UnusableInputError(
                f"{path}:{section.lines.get('AccessType', section.line)}",
                f"AccessType of [{section.name}] is '{access}', expected one of {', '.join(sorted(_ACCESS_TYPES))}",
            )
        for key in ("DataType", "PDOMapping"):
            _integer(path, section, key, 0)


def _integer(path: Path, section: _Section, key: str, default: int) -> int:
    text = section.options.get(key)
    try:
        return default if text is None else int(text, 0)
    except ValueError:
        place = f"{path}:{section.lines.get(key, section.line)}"
        raise UnusableInputError(place, f"{key} of [{section.name}] is '{text}', expected an integer") from None


def _fill_device_information(path: Path, sections: dict[str, _Section], od: canopen.ObjectDictionary) -> None:
    section = sections.get("deviceinfo", _Section("DeviceInfo", 1))
    for key, attribute in _DEVICE_NUMBERS.items():
        if key in section.options:
            setattr(od.device_information, attribute, _integer(path, section, key, 0))
    od.device_information.product_name = section.options.get("ProductName")


def _variable_of(path: Path, section: _Section, index: int, sub: int) -> ODVariable:
    """Variable of a section that `_check_hierarchy` has passed; unknown data types are raw bytes."""
    found = ODVariable(section.options["ParameterName"], index, sub)
    code = _integer(path, section, "DataType", 0)
    found.data_type = int(data_type(code))
    if code != found.data_type:
        found.description = f"data type {code:04X}h, which the file does not define, taken as bytes"
    found.access_type = section.options["AccessType"].lower()
    found.pdo_mappable = bool(_integer(path, section, "PDOMapping", 0))
    if not _depends_on_node(path, section):
        _take_values(path, section, found, 0)
    return found


#: EDS key → attribute of canopen's device information, and of its variable.
_DEVICE_NUMBERS = {
    "VendorNumber": "vendor_number",
    "ProductNumber": "product_number",
    "RevisionNumber": "revision_number",
}
_VALUES = {"DefaultValue": "default", "ParameterValue": "value", "LowLimit": "min", "HighLimit": "max"}


def _take_values(path: Path, section: _Section, target: ODVariable, node_id: int) -> None:
    kind = data_type(target.data_type or 0)
    for key, attribute in _VALUES.items():
        text = section.options.get(key)
        if text is None or (attribute in ("min", "max") and not kind.is_number):
            continue
        try:
            value: Value = kind.parse(text, node_id)
        except ValueError:
            if kind.width is None and attribute == "default":
                continue  # DOMAIN and OCTET_STRING: makers write anything here, and nothing depends on it
            if attribute in ("min", "max") and _is_number(text, node_id):
                continue  # beyond the type's range, such as 65536 of an UNSIGNED16: it limits nothing
            if target.index >= _FIRST_OF_MAKERS and attribute != "value":  # no frame depends on it
                target.description = f"{key} '{text}', left out"
                continue
            place = f"{path}:{section.lines.get(key, section.line)}"
            raise UnusableInputError(
                place, f"{key} of [{section.name}] is '{text}', expected a value of data type {kind:04X}h"
            ) from None
        setattr(target, attribute, value)


def _is_number(text: str, node_id: int) -> bool:
    try:
        DataType.INTEGER64.parse(text, node_id)
    except ValueError:
        return False
    return True
