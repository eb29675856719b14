"""Answers to a SYNC as they arrive in packets: tables for each order of frames, made once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, NmtState
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402 import objects
from hilbench.cia402.state_machine import STATUS_MASK, State
from hilbench.exchange.nodes import Nodes
from hilbench.fast_path import layout as lay
from hilbench.fast_path.bench import DriveFeedback, new_slots_of_kind
from hilbench.fast_path.kernel import Table
from hilbench.fast_path.packet_kernel import Port, new_port
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots

#: Orders of frames that are kept; heartbeats make some of each.
_MOST_ORDERS = 256
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat
_ENABLED = State.OPERATION_ENABLED
_NEVER_NS = 1 << 62

Octets = tuple[int, int]


@dataclass(frozen=True)
class ArrivalOrder:
    """The frames that answer a SYNC, in the order in which they come.

    `table`: of a `kernel.Vectors`; `port`: of a `packet_kernel.Port`, whose arrays are `kept`; `data`: (F, 8) with a
    last row for what does not come; `left`: as of `kernel.exchange`; `heartbeats`: nodes; `rare`: row by COB-ID of the
    PDOs that don't answer each SYNC; `has_status`: whether the status of the twin is among them.
    """

    cob_ids: tuple[int, ...]
    sizes: tuple[int, ...]
    table: Table
    port: Table
    kept: Port
    data: lay.Bytes
    left: memoryview[int]
    heartbeats: Sequence[int]
    rare: dict[int, int]
    has_status: bool


class ArrivalOrders:
    """Cache of the arrival orders met. `make`: the table of `kernel.Vectors` with these frames, fields, rows of
    `layout.VIRTUAL_IO`, data and `left`, the rest shared by all."""

    def __init__(
        self,
        nodes: Nodes,
        seen: DriveFeedback,
        slots: Slots,
        make: Callable[[Frames, lay.Rows, lay.Bytes, lay.Whole], Table],
    ) -> None:
        """Raises FastPathRefusedError where answers are of a kind that only the interpreted cycle knows."""
        self._make = make
        self._known: dict[tuple[int, ...], ArrivalOrder | None] = {}
        self._taken: dict[int, tuple[PdoMap, list[int]]] = {pdo.cob_id: (pdo, slots) for pdo, slots in seen.taken}
        self._statuswords = self._of_statuswords(nodes)
        status = nodes.io.status
        self._status = status.cob_id
        taken = new_slots_of_kind(status, slots, is_float=False)
        self.status = slice(taken[0], taken[-1] + 1)  #: where the values of the twin's status are
        if status.cob_id in nodes.answers:
            self._taken[status.cob_id] = status, taken
        self._virtual_io_rows: list[tuple[int, int, int, int]] = []
        for pdo, part in zip(nodes.io.sent, nodes.measured.parts, strict=True):
            offsets = new_slots_of_kind(pdo, slots, is_float=True)
            self._taken[pdo.cob_id] = pdo, offsets
            self._virtual_io_rows.append((pdo.cob_id, offsets[0], offsets[-1] + 1, part.start))
        self._every = {cob_id: answer.every for cob_id, answer in nodes.answers.items()}
        if set(self._every) != set(self._taken):
            raise FastPathRefusedError
        self._heartbeats = {HEARTBEAT + part.node.node_id for part in nodes.config.parts}

    @staticmethod
    def _of_statuswords(nodes: Nodes) -> dict[int, Octets]:
        found: dict[int, Octets] = {}
        for drive in nodes.drives:
            for _, pdo, indices in drive.pdos.tpdos:
                offset = 0
                for index, kind in zip(indices, pdo.kinds, strict=True):
                    width = kind.width or 0
                    if index == objects.STATUSWORD:
                        found[pdo.cob_id] = offset, offset + width
                    offset += width
        return found

    @property
    def cob_ids(self) -> list[int]:
        """All that may come."""
        return [*self._taken, *self._heartbeats]

    def find(self, cob_ids: tuple[int, ...]) -> ArrivalOrder | None:
        """Find the order of these frames; None: more has to come. Raises FastPathRefusedError where one is no answer
        to SYNC, or came twice."""
        if cob_ids in self._known:
            return self._known[cob_ids]
        came = set(cob_ids)
        if len(came) != len(cob_ids) or not came <= {*self._taken, *self._heartbeats}:
            raise FastPathRefusedError
        if len(self._known) >= _MOST_ORDERS:
            self._known.clear()
        is_all = all(cob_id in came for cob_id, every in self._every.items() if every == 1)
        order = self._known[cob_ids] = self._new(cob_ids) if is_all else None
        return order

    def _new(self, cob_ids: tuple[int, ...]) -> ArrivalOrder:
        frames = Frames()
        checks, heartbeats, rare = [], [], {}
        for row, cob_id in enumerate(cob_ids):
            if cob_id in self._heartbeats:
                frames.add(cob_id, lay.ANSWER, _OPERATIONAL)
                heartbeats.append(cob_id - HEARTBEAT)
                checks.append((row, 0, 1, 0xFF, _OPERATIONAL[0]))
                continue
            pdo, taken = self._taken[cob_id]
            frames.add(cob_id, lay.ANSWER, bytes(pdo.size))
            frames.take(row, pdo, taken)
            if cob_id in self._statuswords:
                begin, end = self._statuswords[cob_id]
                checks.append((row, begin, end - begin, STATUS_MASK[_ENABLED], _ENABLED.value))
            if self._every[cob_id] != 1:
                rare[cob_id] = row
        sizes = tuple(frames.sizes)
        missing = frames.add(HEARTBEAT + LAST_NODE, lay.ANSWER, b"", period_ns=1, next_ns=_NEVER_NS)
        rows = [
            (cob_ids.index(cob_id) if cob_id in cob_ids else missing, *rest) for cob_id, *rest in self._virtual_io_rows
        ]
        data = np.zeros((len(frames.rows), 8), np.uint8)
        left = np.zeros(lay.O_SIZE + len(frames.rows), np.int64)
        table = self._make(frames, np.array(rows, lay.VIRTUAL_IO), data, left)
        wire = np.column_stack((cob_ids, sizes)).astype(np.int64)
        checked = np.array(checks, np.int64).reshape((-1, 5))
        nothing = np.zeros(0, np.uint8)
        port = new_port(-1, 0, wire, checked, wire[:0], left, data.reshape(-1), nothing)
        has_status = self._status in cob_ids
        return ArrivalOrder(cob_ids, sizes, table, port.table(), port, data, left.data, heartbeats, rare, has_status)
