"""Scan of a bus: nodes received, and asked by SDO; nothing is written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hilbench.apps.canopen_tools.eds_match import EdsFile, fitting, read_identity
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.protocol import DEFAULT_BITRATE
from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, NmtState, node_of
from hilbench.canopen.listening import master_at_work, present, receive_for, sort_by_node
from hilbench.canopen.sdo_client import SdoClient
from hilbench.cia402 import objects
from hilbench.cia402.axis import MOST_AXES, SEVERAL, object_of
from hilbench.cia402.state_machine import decode_statusword

_CIA_402 = 402
_AT_ONCE = 16  # requests: what a short transmit queue takes
_ANSWER_S = 0.3  # nodes have been seen that need 0.12 s for 1000h
_FRAME_BITS = 135  # of 8 bytes, with stuff bits: those of requests and answers
_NODE_IDS = range(1, LAST_NODE + 1)


@dataclass(frozen=True)
class Station:
    """A node as it identifies itself; None: it does not, or was not requested to."""

    node_id: int
    nmt_state: str | None = None  #: from its heartbeat
    device_type: int | None = None
    #: Vendor-ID, product code, revision, serial number (1018h).
    identity: tuple[int | None, ...] = (None, None, None, None)
    name: str | None = None  #: 1008h
    hardware: str | None = None  #: 1009h
    firmware: str | None = None  #: 100Ah
    drive_state: str | None = None  #: CiA 402, from the statusword; of several axes one after the other
    eds: Path | None = None  #: the file whose vendor-ID and product code are the device's
    eds_of_revision: bool | None = None  #: and whose revision is, or which is open about it


@dataclass(frozen=True)
class Scan:
    """Nodes on a bus. While another master is active none was requested; `master` gives the evidence."""

    stations: list[Station]
    master: str | None = None
    waited_s: float = 0.0  #: for answers of sixteen nodes at a time; 0: none was requested


def scan(
    link: Link,
    reader: SdoClient,
    files: Sequence[EdsFile],
    listen_s: float,
    master_id: int,
    *,
    bitrate: int = DEFAULT_BITRATE,
    claimed_by: str | None = None,
    ask: bool = True,
) -> Scan:
    """Listen for `listen_s`, then ask every node id, unless another master is at work there or `ask` is false.

    `bitrate` (bit/s): answers are waited for until a bus of that rate has carried them. `claimed_by`: the program that
    has claimed to be the master. Raises BusError when the bus is lost.
    """
    frames = receive_for(link, listen_s)
    received = sort_by_node(frames)
    master = master_at_work(received, claimed_by, master_id)
    states = nmt_states(frames)
    if master or not ask:
        known = sorted(received.nodes.keys() - {master_id})
        return Scan([Station(node_id, states.get(node_id)) for node_id in known], master)
    wait_s = _ANSWER_S + 2 * _AT_ONCE * _FRAME_BITS / bitrate
    answering = {
        node_id
        for first in range(_NODE_IDS.start, _NODE_IDS.stop, _AT_ONCE)
        for node_id in present(link, range(first, min(first + _AT_ONCE, _NODE_IDS.stop)), wait_s)
    }
    found = sorted(answering | received.nodes.keys())
    return Scan([_ask(reader, node_id, states.get(node_id), files) for node_id in found], waited_s=wait_s)


def nmt_states(frames: Iterable[Frame]) -> dict[int, str]:
    """Node id → NMT state by the last heartbeat of each."""
    known = {state.value: state.name.replace("_", "-") for state in NmtState}
    return {
        node_id: known.get(frame.data[0] & 0x7F, f"unknown ({frame.data[0]:02X}h)")
        for frame in frames
        if (node_id := node_of(frame.can_id, HEARTBEAT)) and frame.data
    }


def _ask(reader: SdoClient, node_id: int, nmt_state: str | None, files: Sequence[EdsFile]) -> Station:
    device_type = reader.read(node_id, 0x1000)
    if not isinstance(device_type, bytes):
        return Station(node_id, nmt_state)
    kind = int.from_bytes(device_type, "little")
    identity = read_identity(reader, node_id)
    eds = next(iter(fitting(files, identity)), None)
    name, hardware, firmware = (_text(reader, node_id, index) for index in (0x1008, 0x1009, 0x100A))
    return Station(
        node_id,
        nmt_state,
        kind,
        identity,
        name,
        hardware,
        firmware,
        _drive_states(reader, node_id, kind >> 16) if kind & 0xFFFF == _CIA_402 else None,
        None if eds is None else eds.path,
        None if eds is None else eds.is_of_revision(identity[2]),
    )


def _text(reader: SdoClient, node_id: int, index: int) -> str | None:
    answer = reader.read(node_id, index)
    return answer.decode("latin-1").rstrip("\0 ") if isinstance(answer, bytes) else None


def _drive_states(reader: SdoClient, node_id: int, information: int) -> str | None:
    """States of the axes of a node; `information`: the upper half of 1000h, which states if there are several."""
    states: list[str] = []
    for axis in range(1, (MOST_AXES if information == SEVERAL else 1) + 1):
        answer = reader.read(node_id, object_of(axis, objects.STATUSWORD))
        if not isinstance(answer, bytes):
            break
        state = decode_statusword(int.from_bytes(answer, "little"))
        states.append(state.label if state is not None else "unknown")
    return ", ".join(states) or None
