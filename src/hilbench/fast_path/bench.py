"""The bench in the tables of the fast path: its frames, and what it takes from the answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from hilbench.canopen.identifiers import SYNC
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.drive import Drive
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import layout as lay
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots, feedback_row, new_slots


class BenchFrames(ABC):
    """Frames of each fast-path cycle of a bench: set points, its heartbeat and SYNC, which are the first `asked`, then
    what answers. The slots of their values.

    `targets`: rows of `layout.TARGET`; `boundary_slots`: slots of the twin's boundary inputs; `own_heartbeat`: its row,
    -1: there is none; `virtual_io`: rows of `layout.VIRTUAL_IO`; `status`: row of the twin's status, its first slot.
    """

    def __init__(self, nodes: Nodes, sync: SyncCycle) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self.nodes, self.sync = nodes, sync
        self.slots, self.frames = Slots(), Frames()
        self.targets: list[tuple[float, int, int, int, float]] = []
        self.boundary_slots: list[int] = []
        self.own_heartbeat = -1
        self._send_set_points()
        self._send_boundary_inputs()
        heartbeat, every = sync.heartbeat
        if every:
            count = (sync.timing.cycles - 1) % every
            state = bytes(heartbeat.data)
            self.own_heartbeat = self.frames.add(heartbeat.can_id, lay.BEFORE_SYNC, state, every=every, count=count)
        self.frames.add(SYNC, lay.SYNC, b"")
        self.asked = len(self.frames.rows)
        self.answer()
        self.virtual_io: list[tuple[int, int, int, int]] = []
        self._raw: list[tuple[Drive, dict[int, int]]] = []
        self._take()

    @abstractmethod
    def answer(self) -> None:
        """Add what answers. Raises FastPathRefusedError."""

    def _send_set_points(self) -> None:
        frames, slots = self.frames, self.slots
        for drive, _, _ in self.nodes.set_points:
            rpdo = drive.pdos.rpdo
            controlword, target = new_slots(slots, rpdo)
            slots.whole[controlword] = drive.controlword
            frames.add(rpdo.cob_id, lay.BEFORE_SYNC, rpdo, (controlword, target))
            self.targets.append((drive.set_point_unit, drive.most_raw, target, -1, 1.0))
            for copy in drive.settings.copies:
                copied = slots.new(False)
                frames.add(copy.cob_id, lay.BEFORE_SYNC, rpdo, (controlword, copied))
                self.targets.append((1.0, drive.most_raw, copied, target, copy.factor))

    def _send_boundary_inputs(self) -> None:
        for boundary in self.nodes.io.boundary:
            if not all(kind.is_float for kind in boundary.kinds):
                raise FastPathRefusedError
            boundary_slots = new_slots(self.slots, boundary)
            self.frames.add(boundary.cob_id, lay.BEFORE_SYNC, boundary, boundary_slots)
            self.boundary_slots += boundary_slots

    def _take(self) -> None:
        """Take feedback of the drives, each of whose TPDOs answers each SYNC in whole numbers, and what the twin's
        virtual I/O brings."""
        nodes = self.nodes
        for drive in nodes.drives:
            raw: dict[int, int] = {}
            for _, pdo, indices in drive.pdos.tpdos:
                if pdo.period != 1:
                    raise FastPathRefusedError
                raw.update(zip(indices, self._take_pdo(pdo, is_float=False)[1], strict=True))
            self._raw.append((drive, raw))
        row, taken = self._take_pdo(nodes.io.status, is_float=False)
        self.status = row, taken[0]
        for pdo, part in zip(nodes.io.sent, nodes.measured.parts, strict=True):
            row, taken = self._take_pdo(pdo, is_float=True)
            self.virtual_io.append((row, taken[0], taken[-1] + 1, part.start))

    def _take_pdo(self, pdo: PdoMap, *, is_float: bool) -> tuple[int, list[int]]:
        """Take a TPDO: its row, and the slots of its values."""
        if any(kind.is_float is not is_float for kind in pdo.kinds):
            raise FastPathRefusedError
        row, taken = self.frames.row_of(pdo.cob_id), new_slots(self.slots, pdo)
        self.frames.take(row, pdo, taken)
        return row, taken

    @property
    def feedback(self) -> list[tuple[Any, ...]]:
        """Rows of `layout.FEEDBACK` for the drives now. Raises FastPathRefusedError if a drive's state is unknown."""
        return [feedback_row(drive, raw) for drive, raw in self._raw]

    def give(self, seen: lay.Rows, whole: lay.Whole) -> None:
        """The drives know what has come."""
        values = whole.tolist()
        for (drive, raw), row in zip(self._raw, seen, strict=True):
            drive.counter.counted_until(int(row["value"]), int(row["last"]))
            drive.decoded_until({index: values[slot] for index, slot in raw.items()})
