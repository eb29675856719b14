"""Who is on the bus, and what the bench's nodes say of themselves: listened to and read by SDO, never written to."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hilbench.bus.frame import Frame
from hilbench.bus.link import Link
from hilbench.fieldbus.sdo_reader import Answer, SdoReader

_SYNC = 0x080
_SDO_REQUEST, _SDO_ANSWER = 0x600, 0x580
#: Function codes of what a node sends in the predefined connection set (CiA 301): EMCY, TPDO1 to 4, SDO, heartbeat.
_SENT_BY_NODES = (0x080, 0x180, 0x280, 0x380, 0x480, _SDO_ANSWER, 0x700)
_READ_DEVICE_TYPE = bytes([0x40, 0x00, 0x10, 0x00]) + bytes(4)
_IDENTITY_ENTRIES = 3  # vendor id, product code, revision number


@dataclass(frozen=True)
class Heard:
    """What others sent while nobody was asked anything."""

    nodes: Mapping[int, frozenset[int]] = field(default_factory=dict)  #: node id → COB-IDs it used
    sync: bool = False

    def another_master(self, master_id: int) -> bool:
        """Whether somebody else sends SYNC, or under the node id of the bench."""
        return self.sync or master_id in self.nodes


@dataclass(frozen=True)
class MappedObject:
    """An object that the bench maps into a PDO, with its length by the EDS in bits."""

    index: int
    sub: int
    name: str
    bits: int


@dataclass(frozen=True)
class ExpectedNode:
    """A node of the config, as its EDS file has it; None where the file says nothing."""

    part: str
    node_id: int
    eds: Path
    ours: bool  #: `hilbench run` starts it: simulated hardware or twin
    device_type: int | None = None
    #: Vendor id, product code and revision: for each, what [DeviceInfo] and 1018h give (0 stands for nothing).
    identity: tuple[frozenset[int], ...] = (frozenset(), frozenset(), frozenset())
    mapped: tuple[MappedObject, ...] = ()

    @property
    def subject(self) -> str:
        """How it is called in findings."""
        return f"{self.part.replace('_', ' ')} (node {self.node_id})"


@dataclass(frozen=True)
class NodeAnswers:
    """What one node answered; only `device_type` when it gave no answer to that."""

    device_type: Answer
    identity: tuple[Answer, ...] = ()
    mapped: Mapping[tuple[int, int], Answer] = field(default_factory=dict)


def sort_by_node(frames: Iterable[Frame]) -> Heard:
    """Which node ids the identifiers belong to, by the predefined connection set."""
    nodes: dict[int, set[int]] = {}
    sync = False
    for frame in frames:
        function, node_id = frame.can_id & ~0x7F, frame.can_id & 0x7F
        if frame.can_id == _SYNC:
            sync = True
        elif function in _SENT_BY_NODES and node_id:
            nodes.setdefault(node_id, set()).add(frame.can_id)
    return Heard({node_id: frozenset(nodes[node_id]) for node_id in sorted(nodes)}, sync)


def listen(link: Link, duration_s: float) -> Heard:
    """Hear what others send. Raises BusError when the bus is lost."""
    return sort_by_node(hear(link, duration_s))


def present(link: Link, node_ids: Iterable[int], wait_s: float) -> set[int]:
    """Which of these nodes answer an SDO read of 1000h within `wait_s`; all are asked at once."""
    asked = list(node_ids)
    link.send([Frame(_SDO_REQUEST + node_id, _READ_DEVICE_TYPE) for node_id in asked])
    answered = {frame.can_id - _SDO_ANSWER for frame in hear(link, wait_s)}
    return answered & set(asked)


def hear(link: Link, duration_s: float) -> list[Frame]:
    """All frames of a time. Raises BusError when the bus is lost."""
    frames: list[Frame] = []
    deadline_s = time.monotonic() + duration_s
    while (remaining_s := deadline_s - time.monotonic()) > 0:
        frames += link.receive(remaining_s)
    return frames


def ask(reader: SdoReader, node: ExpectedNode) -> NodeAnswers:
    """Read device type, identity and the mapped objects of one node."""
    device_type = reader.read(node.node_id, 0x1000)
    if device_type is None:
        return NodeAnswers(None)
    return NodeAnswers(
        device_type,
        tuple(reader.read(node.node_id, 0x1018, sub) for sub in range(1, 1 + _IDENTITY_ENTRIES)),
        {(item.index, item.sub): reader.read(node.node_id, item.index, item.sub) for item in node.mapped},
    )
