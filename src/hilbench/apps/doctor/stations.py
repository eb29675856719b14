"""Identities and states of the bench's nodes: read by SDO, never written to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hilbench.canopen.sdo_client import Answer, SdoClient

_IDENTITY_ENTRIES = 3  # vendor id, product code, revision number


@dataclass(frozen=True)
class MappedObject:
    """An object that the bench maps into a PDO, with its length by the EDS in bits."""

    index: int
    sub: int
    name: str
    bits: int


@dataclass(frozen=True)
class ExpectedNode:
    """A node of the config, as its EDS file has it; None where the file does not state it."""

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
        """Name of the node in findings."""
        return f"{self.part.replace('_', ' ')} (node {self.node_id})"


@dataclass(frozen=True)
class NodeAnswers:
    """Answers of one node; only `device_type` when it gave no answer to that."""

    device_type: Answer
    identity: tuple[Answer, ...] = ()
    mapped: Mapping[tuple[int, int], Answer] = field(default_factory=dict)


def ask(reader: SdoClient, node: ExpectedNode) -> NodeAnswers:
    """Read device type, identity and the mapped objects of one node."""
    device_type = reader.read(node.node_id, 0x1000)
    if device_type is None:
        return NodeAnswers(None)
    return NodeAnswers(
        device_type,
        tuple(reader.read(node.node_id, 0x1018, sub) for sub in range(1, 1 + _IDENTITY_ENTRIES)),
        {(item.index, item.sub): reader.read(node.node_id, item.index, item.sub) for item in node.mapped},
    )
