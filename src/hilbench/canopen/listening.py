"""Nodes on the bus: received, by the identifiers of the predefined connection set (CiA 301), or read (1000h)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.emergency_stop import EMERGENCY_STOP, EMERGENCY_STOP_COB_ID
from hilbench.canopen.identifiers import EMERGENCY, HEARTBEAT, NMT, NODE_ID, RPDOS, SDO_ANSWER, SDO_REQUEST, SYNC, TPDOS

#: Function codes of what a node sends: EMCY, TPDO1 to 4, SDO, heartbeat.
_SENT_BY_NODES: Final = (EMERGENCY, *TPDOS, SDO_ANSWER, HEARTBEAT)
_READ_DEVICE_TYPE: Final = bytes([0x40, 0x00, 0x10, 0x00]) + bytes(4)
#: After the first sign of a master: until what else it sends has come.
_LOOK_ROUND_S: Final = 0.1


@dataclass(frozen=True)
class Received:
    """Frames that others sent without a request."""

    nodes: Mapping[int, frozenset[int]] = field(default_factory=dict)  #: node id → COB-IDs it used
    sync: int = 0  #: frames of SYNC
    nmt: int = 0  #: NMT commands, except those of an emergency stop, which any node may send
    set_points: frozenset[int] = frozenset()  #: COB-IDs of RPDOs

    def signs_of_master(self, master_id: int) -> list[str]:
        """Signs of another master at work, as text with the identifiers; empty if none."""
        signs = []
        if self.sync:
            signs.append(f"SYNC (080h, {_times(self.sync)})")
        if self.nmt:
            signs.append(f"NMT commands (000h, {_times(self.nmt)})")
        if self.set_points:
            signs.append(f"set points (RPDO {_hex(self.set_points)})")
        if master_id in self.nodes:
            signs.append(f"node {master_id}, which is the bench's own id ({_hex(self.nodes[master_id])})")
        return signs


def master_at_work(received: Received, claimed_by: str | None, master_id: int) -> str | None:
    """Text on another master: the program that has claimed the bus, or else its frames received. None: no sign."""
    signs = ", ".join(received.signs_of_master(master_id))
    if claimed_by is not None:
        return f"{claimed_by}; received: {signs or 'nothing of it'}"
    return f"received {signs}; no program of this machine has claimed the bus" if signs else None


def sort_by_node(frames: Iterable[Frame]) -> Received:
    """Attribute frames to nodes by their identifiers."""
    nodes: dict[int, set[int]] = {}
    set_points: set[int] = set()
    sync, commands, stopped = 0, list[bytes](), False
    for can_id, data, _ in frames:
        function, node_id = can_id & ~NODE_ID, can_id & NODE_ID
        if can_id == SYNC:
            sync += 1
        elif can_id == NMT:
            commands.append(bytes(data))
        elif can_id == EMERGENCY_STOP_COB_ID:
            stopped = True
        elif function in _SENT_BY_NODES and node_id:
            nodes.setdefault(node_id, set()).add(can_id)
        elif function in RPDOS and node_id:
            set_points.add(can_id)
    nmt = [data for data in commands if not (stopped and data == EMERGENCY_STOP[1].data)]
    by_node = {node_id: frozenset(nodes[node_id]) for node_id in sorted(nodes)}
    return Received(by_node, sync, len(nmt), frozenset(set_points))


def listen(link: Link, duration_s: float) -> Received:
    """Receive frames of others for `duration_s`. Raises BusError when the bus is lost."""
    return sort_by_node(receive_for(link, duration_s))


def listen_for_master(link: Link, duration_s: float, master_id: int) -> list[str]:
    """Signs of another master; takes `duration_s` where there is none. Raises BusError when the bus is lost."""
    frames = receive_for(link, duration_s, lambda new: bool(sort_by_node(new).signs_of_master(master_id)))
    if sort_by_node(frames).signs_of_master(master_id):
        frames += receive_for(link, _LOOK_ROUND_S)
    return sort_by_node(frames).signs_of_master(master_id)


def present(link: Link, node_ids: Iterable[int], wait_s: float) -> set[int]:
    """Nodes of `node_ids` that answer an SDO read of 1000h within `wait_s`; all are read at once."""
    asked = set(node_ids)
    link.send([Frame(SDO_REQUEST + node_id, _READ_DEVICE_TYPE) for node_id in sorted(asked)])
    answers: set[int] = set()

    def everybody(frames: list[Frame]) -> bool:
        answers.update(frame.can_id - SDO_ANSWER for frame in frames)
        return answers >= asked

    receive_for(link, wait_s, everybody)
    return answers & asked


def receive_for(
    link: Link, duration_s: float, enough: Callable[[list[Frame]], bool] = lambda new: False
) -> list[Frame]:
    """All frames of a time, or until `enough` returns true for new ones. Raises BusError when the bus is lost.

    Frames received by the end of that time are among them, however late this process is scheduled.
    """
    frames: list[Frame] = []
    deadline_s = time.monotonic() + duration_s
    while True:
        remaining_s = max(0.0, deadline_s - time.monotonic())
        new = link.receive(remaining_s)
        frames += new
        if enough(new) or remaining_s == 0.0:
            break
    return frames


def _hex(identifiers: Iterable[int]) -> str:
    return " ".join(f"{identifier:03X}h" for identifier in sorted(identifiers))


def _times(count: int) -> str:
    return f"{count} frame" if count == 1 else f"{count} frames"
