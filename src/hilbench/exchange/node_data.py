"""Objects read from a bench's drives and values written into them: `nodes.json` of a run folder.

Read before the bench configures them: device type, names, versions and identity (1000h, 1008h to 100Ah, 1018h), what
their units follow from (CiA 402-2: 6076h, 6089h to 6097h with 608Fh to 6092h, 60A8h to 60ABh), the objects that the
writes, and the PDOs that the bench maps; with the defaults of their EDS files.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import ClassVar, Final

from canopen.objectdictionary import ObjectDictionary
from pydantic import Field

from hilbench.block import Strict
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type
from hilbench.canopen.eds import shared_eds
from hilbench.canopen.identifiers import MAPPING
from hilbench.canopen.sdo_client import Refusal, SdoClient
from hilbench.cia402 import configuration, objects
from hilbench.cia402.axis import MOST_AXES, is_of, object_of, of_first_axis
from hilbench.exchange.addressing import dictionary_of, drive_settings
from hilbench.exchange.nodes import ForEachNode
from hilbench.json_file import JsonFile
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part

Key = tuple[int, int]

FILE: Final = "nodes.json"
DEVICE: Final[tuple[Key, ...]] = (
    (0x1000, 0),
    (0x1008, 0),
    (0x1009, 0),
    (0x100A, 0),
    *((0x1018, k) for k in (1, 2, 3, 4)),
)
#: What a device's units follow from, of each axis.
UNITS: Final = frozenset(
    object_of(axis, index)
    for axis in range(1, MOST_AXES + 1)
    for index in (objects.MOTOR_RATED_TORQUE, *range(0x6089, 0x6098), *range(0x60A8, 0x60AC))
)
#: Not the mode (6060h), in which who moves a drive by hand may have left it.
_SET_BY_THE_BENCH: Final = (
    configuration.CONSUMER_HEARTBEAT,
    configuration.PRODUCER_HEARTBEAT,
    objects.INTERPOLATION_TIME_PERIOD,
)
_MOST_MAPPED: Final = 64
_OF_PDOS: Final = range(0x1400, 0x1C00)


def name_of(key: Key) -> str:
    """Object name as in a config and in messages: ``60A9h``, ``60C2h:1``."""
    return f"{key[0]:04X}h" + (f":{key[1]}" if key[1] else "")


class NodeData(Strict):
    """Objects of one drive before the bench configured it, and what was written; bytes as hexadecimal text
    by object, None where the device aborted the read."""

    node_id: int
    eds: str
    started: bool = Field(description="the run started it: it is the simulated hardware's")
    found: dict[str, str | None]
    written: dict[str, str]


class EdsObject(Strict):
    """An object of an EDS file: its data type, access type, whether it can be mapped, and its default as text."""

    type: int
    access: str
    mappable: bool
    default: str | None


class StandData(JsonFile):
    """Objects of a stand's nodes at the start of a run. `eds`: by file, the objects in it."""

    described: ClassVar[str] = "a run's nodes"
    indent: ClassVar[int] = 1

    stand: str
    time: datetime
    nodes: dict[str, NodeData]
    eds: dict[str, dict[str, EdsObject]]


def ask_all(
    reader: SdoClient, config: BenchConfig, for_each_node: ForEachNode = map
) -> dict[str, dict[Key, bytes | None]]:
    """Read each drive's objects, by part: bytes by object, None where the read is aborted; empty for a silent drive.

    Raises BusError when the bus is lost.
    """
    parts = config.stand_drives
    answers = for_each_node(partial(ask, reader, config), parts)
    return {part.name: of_part for part, of_part in zip(parts, answers, strict=True)}


def ask(reader: SdoClient, config: BenchConfig, part: Part) -> dict[Key, bytes | None]:
    """Read the objects of one drive; empty when it does not answer."""
    od = dictionary_of(part)
    found: dict[Key, bytes | None] = {}
    wanted = [*DEVICE, *_parameters(config, part)]
    pdos = [index for index in _pdos(config, part) if index in od]
    for communication in pdos:
        wanted += [(communication, 1), (communication, 2), (communication + MAPPING, 0)]
    for index, sub in wanted:
        answer = reader.read(part.node.node_id, index, sub)
        if answer is None:
            return {}
        found[index, sub] = None if isinstance(answer, Refusal) else answer
        if index - MAPPING in pdos and sub == 0 and isinstance(answer, bytes):
            count = min(int.from_bytes(answer[:1], "little"), _MOST_MAPPED)
            for entry in range(1, count + 1):
                answers = reader.read(part.node.node_id, index, entry)
                found[index, entry] = answers if isinstance(answers, bytes) else None
    return found


def _pdos(config: BenchConfig, part: Part) -> list[int]:
    """Communication parameters of the PDOs that a drive's part has."""
    pdos = configuration.drive_pdos(drive_settings(config, part), dictionary_of(part))
    return [pdo.communication for pdo in pdos.all]


def _writes_of(
    config: BenchConfig, part: Part, written: Mapping[tuple[int, int, int], bytes]
) -> Iterator[tuple[Key, bytes]]:
    """What was written to a part; of the PDOs of its node those that it has."""
    own = {index + behind for index in _pdos(config, part) for behind in (0, MAPPING)}
    for (node_id, index, sub), data in written.items():
        if node_id != part.node.node_id:
            continue
        if index in own or (index not in _OF_PDOS and is_of(part.node_axis, index)):
            yield (index, sub), data


def _parameters(config: BenchConfig, part: Part) -> list[Key]:
    """The objects that units follow from, and those that are written."""
    written = drive_settings(config, part).parameters
    return [
        (each.index, each.subindex)
        for each in eds.all_variables(dictionary_of(part))
        if is_of(part.node_axis, each.index)
        and (
            (each.index in UNITS and each.readable)
            or of_first_axis(each.index) in _SET_BY_THE_BENCH
            or (each.index, each.subindex) in written
        )
    ]


def stand_data(
    config: BenchConfig,
    found: Mapping[str, Mapping[Key, bytes | None]],
    written: Mapping[tuple[int, int, int], bytes],
    *,
    started: Iterable[int],
) -> StandData:
    """Data of a run's nodes. `written`: bytes by node id, index and sub-index; `started`: ids of simulated nodes.

    Raises UnusableInputError for an EDS file that can't be used.
    """
    brought = frozenset(started)
    nodes = {
        part.name: NodeData(
            node_id=part.node.node_id,
            eds=str(part.node.eds),
            started=part.node.node_id in brought,
            found={name_of(key): None if data is None else data.hex() for key, data in found[part.name].items()},
            written={name_of(key): data.hex() for key, data in _writes_of(config, part, written)},
        )
        for part in config.stand_drives
    }
    files = {str(part.node.eds): eds_objects(part.node.eds) for part in config.stand_drives}
    return StandData(stand=config.stand_name, time=datetime.now(UTC), nodes=nodes, eds=files)


def eds_objects(path: Path) -> dict[str, EdsObject]:
    """The objects of an EDS file; ``$NODEID`` counts as 0. Raises UnusableInputError."""
    return {
        name_of((each.index, each.subindex)): EdsObject(
            type=each.data_type or 0,
            access=each.access_type,
            mappable=each.pdo_mappable,
            default=None if each.default is None else str(each.default),
        )
        for each in eds.all_variables(shared_eds(path, 0))
    }


def text_of(od: ObjectDictionary, key: Key, data: bytes | None) -> str:
    """Readable text of an object's value, by its type in an EDS file."""
    if data is None:
        return "not told"
    try:
        variable = eds.variable(od, *key)
        value = data_type(variable.data_type or 0).decode(data)
    except (KeyError, ValueError):
        value = int.from_bytes(data, "little") if len(data) <= 4 else data.decode("latin-1").rstrip("\0")
    if key[0] in (0x1008, 0x1009, 0x100A) and isinstance(value, bytes):
        value = value.decode("latin-1")
    if isinstance(value, int) and (key[0] < 0x2000 or of_first_axis(key[0]) in range(0x60A8, 0x60AC)):
        return f"{value & 0xFFFFFFFF:08X}h"
    return repr(value) if isinstance(value, str) else str(value)
