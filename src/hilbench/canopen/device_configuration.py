"""Configuration of a device as a whole: read from it, kept as DCF (CiA 306) or concise DCF, written, compared.

A configuration is bytes by (index, sub-index), as in SDO transfers; the object dictionary gives their types.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from canopen.objectdictionary import ODVariable

import canopen
from hilbench.canopen import concise_dcf, eds
from hilbench.canopen.concise_dcf import Write
from hilbench.canopen.data_types import DataType, Value, data_type
from hilbench.canopen.identifiers import MAPPING, NODE_ID, pdo_name
from hilbench.canopen.master import Master
from hilbench.canopen.object_store import NO_DATA
from hilbench.canopen.sdo_client import Refusal, reason_of
from hilbench.canopen.storage import NO_PARAMETERS
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.files import content, usable, write_whole, written_whole

#: (index, sub-index).
Key = tuple[int, int]

_READABLE: Final = ("ro", "rw", "rwr", "rww", "const")
_WRITABLE: Final = ("rw", "rwr", "rww")
_EMERGENCY_COB_ID: Final = 0x1014
_TRIES: Final = 3


@dataclass
class Configuration:
    """Object values of a device or a file. `refused`: objects that could not be read, and why."""

    od: canopen.ObjectDictionary
    values: dict[Key, bytes] = field(default_factory=dict)
    refused: dict[Key, str] = field(default_factory=dict)

    def shown(self, key: Key) -> str:
        """Readable value of an object."""
        data = self.values.get(key)
        return "-" if data is None else shown(eds.variable(self.od, *key), data)

    def name(self, key: Key) -> str:
        """The object's index and name."""
        name = getattr(eds.known(self.od, *key), "name", "(in no EDS file)")
        return f"{key[0]:04X}h sub {key[1]} {name}"


@dataclass(frozen=True)
class Difference:
    """An object that has another value on the other side; None: it is not there."""

    key: Key
    name: str
    first: str | None
    second: str | None


def shown(variable: ODVariable, data: bytes) -> str:
    """Bytes of an object as a number with its hexadecimal form, as text, or as bytes."""
    try:
        value = data_type(variable.data_type or 0).decode(data)
    except ValueError:
        return data.hex(" ")
    if isinstance(value, bytes):
        return value.hex(" ")
    return f"{value} ({value:X}h)" if isinstance(value, int) and value > 9 else str(value)


# -- from and to a device ----------------------------------------------------------------------------------------


def read_device(
    master: Master, node_id: int, od: canopen.ObjectDictionary, progress: Callable[[int, int], None] = lambda *_: None
) -> Configuration:
    """Read all readable objects of a device except DOMAIN ones; `progress(done, all)` is called for each.

    Raises BenchFaultError when the device does not answer.
    """
    found = Configuration(od)
    # Contents of DOMAIN objects are programs and files, not settings.
    wanted = [v for v in eds.all_variables(od) if v.access_type in _READABLE and v.data_type != DataType.DOMAIN]
    for number, variable in enumerate(wanted, 1):
        key = variable.index, variable.subindex
        answer = master.read(node_id, *key)
        if answer is None:
            if not _is_there(master, node_id):
                raise BenchFaultError(f"node {node_id}: no answer when {found.name(key)} was read")
            found.refused[key] = f"no answer within {master.timeout_s:g} s, or that of another object"
        elif isinstance(answer, Refusal):
            if answer.code != NO_DATA:  # such as an empty entry of the error history
                found.refused[key] = str(answer)
        else:
            width = data_type(variable.data_type or 0).width
            found.values[key] = answer[:width] if width is not None else answer
        progress(number, len(wanted))
    return found


def settings(configuration: Configuration) -> list[Write]:
    """The writes that give a device this configuration, in an order that it accepts: PDOs by CiA 301's procedure
    (invalid, no entries, entries, their number, parameters, valid), then the rest by index.

    Commands and set points (1010h, 6040h, …) are none.
    """
    values = {key: configuration.values[key] for key in _parameters(configuration)}
    pdos = sorted({index for index in map(_pdo_of, values) if index})
    # Entries beyond the number of a mapping mean nothing, and a device may refuse to have them written.
    mappings = {index + MAPPING for index in pdos}
    writes = [write for index in pdos for write in _pdo_writes(values, index)]
    done = {write.key for write in writes}
    rest = sorted((key, data) for key, data in values.items() if key not in done and key[0] not in mappings)
    return writes + [Write(*key, data) for key, data in rest]


def moved(writes: Sequence[Write], from_node: int, to_node: int) -> tuple[list[Write], list[Key]]:
    """Convert writes to another node id: COB-IDs with the one get the other. Returns them, and the keys changed."""
    found, changed = [], []
    for write in writes:
        value = int.from_bytes(write.data, "little")
        if _is_cob_id(write) and value & NODE_ID == from_node != to_node:
            data = (value & ~NODE_ID | to_node).to_bytes(len(write.data), "little")
            found.append(replace(write, data=data))
            changed.append(write.key)
        else:
            found.append(write)
    return found, sorted(set(changed))


def _is_cob_id(write: Write) -> bool:
    is_pdo = write.sub == 1 and pdo_name(write.index)
    return len(write.data) == 4 and bool(is_pdo or write.key == (_EMERGENCY_COB_ID, 0))


def write_device(
    master: Master, node_id: int, writes: list[Write], progress: Callable[[int, int], None] = lambda *_: None
) -> dict[Key, str]:
    """Write all of them in order, and read back what they leave. Returns objects that kept another value, and why.

    Raises BenchFaultError when the device does not answer.
    """
    failed: dict[Key, str] = {}
    for number, write in enumerate(writes, 1):
        key = write.key
        try:
            master.download(node_id, *key, write.data)
        except canopen.SdoAbortedError as error:
            if master.read(node_id, *key) != write.data:  # a value already there need not be written
                failed[key] = f"{write.data.hex(' ')} refused: {Refusal(error.code)}"
        except canopen.SdoCommunicationError as error:
            if not _is_there(master, node_id):
                raise BenchFaultError(
                    f"node {node_id}: no answer when {key[0]:04X}h sub {key[1]} was written ({number} of {len(writes)})"
                ) from error
            failed[key] = reason_of(error, master.timeout_s)
        progress(number, len(writes))
    last = {write.key: write.data for write in writes}
    for key, data in last.items():
        answer = master.read(node_id, *key)
        if key not in failed and isinstance(answer, bytes) and answer[: len(data)] != data:
            failed[key] = f"reads back {answer.hex(' ')}, expected {data.hex(' ')} as written"
    return failed


def _is_there(master: Master, node_id: int) -> bool:
    """True if the device answers at all, as one object may be slow; late answers pass meanwhile."""
    return any(master.read(node_id, 0x1000) for _ in range(_TRIES))


def _parameters(configuration: Configuration) -> Iterator[Key]:
    for variable in eds.all_variables(configuration.od):
        key = variable.index, variable.subindex
        if key in configuration.values and variable.access_type in _WRITABLE and variable.index not in NO_PARAMETERS:
            yield key


def _pdo_of(key: Key) -> int | None:
    """The communication parameters of the PDO that is set up by an object: by its COB-ID, or by its mapping."""
    index, sub = key
    if sub == 1 and pdo_name(index):
        return index
    return index - MAPPING if sub == 0 and pdo_name(index - MAPPING) else None


def _pdo_writes(values: Mapping[Key, bytes], index: int) -> Iterator[Write]:
    """cob_id: of some devices it is read-only, and the mapping is not."""
    cob_id, mapping = values.get((index, 1)), index + MAPPING
    number = values.get((mapping, 0))
    if cob_id is not None:
        yield Write(index, 1, cob_id[:-1] + bytes([cob_id[-1] | 0x80]))
    if number is not None:
        yield Write(mapping, 0, b"\0")
        for sub in range(1, number[0] + 1):
            if (mapping, sub) in values:
                yield Write(mapping, sub, values[mapping, sub])
        yield Write(mapping, 0, number)
    for (at, sub), data in sorted(values.items()):
        if at == index and sub > 1:
            yield Write(index, sub, data)
    if cob_id is not None:
        yield Write(index, 1, cob_id)


# -- from and to a file ------------------------------------------------------------------------------------------


def is_concise(path: Path) -> bool:
    """True if a file of this name is a concise DCF."""
    return path.suffix.lower() in (".bin", ".cdcf")


def writes_of_file(path: Path, od: canopen.ObjectDictionary) -> list[Write]:
    """Writes of a file for a device with this object dictionary; those of a concise DCF in its own order.

    Raises UnusableInputError for a file that is none, or one without a value.
    """
    return _read_concise(path) if is_concise(path) else settings(read_file(path, od))


def read_file(path: Path, od: canopen.ObjectDictionary) -> Configuration:
    """The values that a DCF, or a concise DCF (.bin, .cdcf), has for a device with this object dictionary.

    Raises UnusableInputError for a file that is none, or one without a value.
    """
    if is_concise(path):
        return Configuration(od, {write.key: write.data for write in _read_concise(path)})
    file = eds.load_eds(path, od.node_id or 0)
    values = {
        (variable.index, variable.subindex): data_type(variable.data_type or 0).encode(variable.value)
        for variable in eds.all_variables(file)
        if variable.value is not None
    }
    if not values:
        raise UnusableInputError(path, "no object has a ParameterValue, expected a DCF (hilbench sdo dump writes one)")
    return Configuration(file, values)


def _read_concise(path: Path) -> list[Write]:
    with usable(path, "read", "a concise DCF"):
        found = content(path, eds.MOST_BYTES)
    try:
        return concise_dcf.decode(found)
    except ValueError as error:
        raise UnusableInputError(path, f"{error}; expected a concise DCF (CiA 302-3)") from error


def node_of_file(path: Path) -> int | None:
    """Node id that a DCF was made for (DeviceComissioning, as CiA 306 spells it); None: it is not given."""
    try:
        return int(eds.option(path, "DeviceComissioning", "NodeID"), 0)
    except (UnusableInputError, ValueError):
        return None


def write_dcf(configuration: Configuration, path: Path) -> None:
    """Write a DCF: the objects of the EDS file with the values as ParameterValue. Raises UnusableInputError."""
    od = configuration.od
    for variable in eds.all_variables(od):
        data = configuration.values.get((variable.index, variable.subindex))
        # canopen writes -1 as 0x-1 and 0.5 as 0.5; the texts of CiA 306 are given to it.
        if isinstance(variable.default, int | float):
            default = data_type(variable.data_type or 0).encode(variable.default)
            variable.default_raw = _text(variable, default)  # type: ignore[attr-defined]
        variable.value_raw = None if data is None else _text(variable, data)  # type: ignore[attr-defined]
    text = io.StringIO()
    canopen.export_od(od, text, doc_type="dcf")
    write_whole(path, text.getvalue())


def write_concise(configuration: Configuration, path: Path) -> None:
    """Write the settings as a concise DCF. Raises UnusableInputError."""
    with written_whole(path) as partial:
        partial.write_bytes(concise_dcf.encode(settings(configuration)))


def _text(variable: ODVariable, data: bytes) -> str:
    """Text of a value as CiA 306 has it: of a floating-point number its bits."""
    kind = data_type(variable.data_type or 0)
    if kind.is_float:
        return "0x" + data[::-1].hex().upper()
    try:
        value: Value = kind.decode(data)
    except ValueError:
        value = data
    return value.hex() if isinstance(value, bytes) else str(value)


# -- compared ----------------------------------------------------------------------------------------------------


def differences(first: Configuration, second: Configuration, *, all_objects: bool = False) -> list[Difference]:
    """Objects whose values differ, by index. Without `all_objects` settings only, and those that both sides have."""
    if all_objects:
        keys = sorted({*first.values, *second.values})
    else:
        keys = sorted(set(_parameters(first)) & set(second.values))
    return [
        Difference(key, first.name(key), _side(first, key), _side(second, key))
        for key in keys
        if first.values.get(key) != second.values.get(key)
    ]


def _side(configuration: Configuration, key: Key) -> str | None:
    return configuration.shown(key) if key in configuration.values else None
