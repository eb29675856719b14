"""The bench in the tables of the fast path: its frames, and the feedback it takes from the drives."""

from __future__ import annotations

from typing import Any

from hilbench.canopen.identifiers import SYNC
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.drive import Drive
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import layout as lay
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots, feedback_row, new_slots


class BenchFrames:
    """Set points, the bench's heartbeat and SYNC, in their order; no frame after them is the bench's.

    `targets`: rows of `layout.TARGET`; `controlwords`: the slot of each drive's; `boundary_slots`: slots of the
    twin's boundary inputs; `own_heartbeat`: its row, -1: there is none.
    """

    def __init__(self, nodes: Nodes, sync: SyncCycle, frames: Frames, slots: Slots) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self.targets: list[tuple[float, int, int, int, float]] = []
        self.controlwords: list[tuple[int, Drive]] = []
        self.boundary_slots: list[int] = []
        self.own_heartbeat = -1
        for drive, _, _ in nodes.set_points:
            rpdo = drive.pdos.rpdo
            controlword, target = new_slots(slots, rpdo)
            slots.whole[controlword] = drive.controlword
            self.controlwords.append((controlword, drive))
            frames.add(rpdo.cob_id, lay.BEFORE_SYNC, rpdo, (controlword, target))
            self.targets.append((drive.set_point_unit, drive.most_raw, target, -1, 1.0))
            for copy in drive.settings.copies:
                copied = slots.new(False)
                frames.add(copy.cob_id, lay.BEFORE_SYNC, rpdo, (controlword, copied))
                self.targets.append((1.0, drive.most_raw, copied, target, copy.factor))
        for boundary in nodes.io.boundary:
            if not all(kind.is_float for kind in boundary.kinds):
                raise FastPathRefusedError
            boundary_slots = new_slots(slots, boundary)
            frames.add(boundary.cob_id, lay.BEFORE_SYNC, boundary, boundary_slots)
            self.boundary_slots += boundary_slots
        heartbeat, every = sync.heartbeat
        if every:
            count = (sync.timing.cycles - 1) % every
            state = bytes(heartbeat.data)
            self.own_heartbeat = frames.add(heartbeat.can_id, lay.BEFORE_SYNC, state, every=every, count=count)
        frames.add(SYNC, lay.SYNC, b"")


class DriveFeedback:
    """Feedback that the bench takes from the drives' TPDOs: slots by object index, and each
    PDO with its slots."""

    def __init__(self, nodes: Nodes, slots: Slots) -> None:
        """Raises FastPathRefusedError where one does not answer each SYNC in whole numbers."""
        self.raw: list[tuple[Drive, dict[int, int]]] = []
        self.taken: list[tuple[PdoMap, list[int]]] = []
        for drive in nodes.drives:
            raw: dict[int, int] = {}
            for _, pdo, indices in drive.pdos.tpdos:
                if pdo.period != 1 or any(kind.is_float for kind in pdo.kinds):
                    raise FastPathRefusedError
                taken = new_slots(slots, pdo)
                self.taken.append((pdo, taken))
                raw.update(zip(indices, taken, strict=True))
            self.raw.append((drive, raw))

    def rows(self) -> list[tuple[Any, ...]]:
        """Rows of `layout.FEEDBACK` for the drives now. Raises FastPathRefusedError if a drive's state is unknown."""
        return [feedback_row(drive, raw) for drive, raw in self.raw]

    def give(self, seen: lay.Rows, whole: lay.Whole) -> None:
        """The drives know what has come."""
        values = whole.tolist()
        for (drive, raw), row in zip(self.raw, seen, strict=True):
            drive.counter.counted_until(int(row["value"]), int(row["last"]))
            drive.decoded_until({index: values[slot] for index, slot in raw.items()})


def new_slots_of_kind(pdo: PdoMap, slots: Slots, *, is_float: bool) -> list[int]:
    """New slots for the values of a TPDO of the virtual I/O. Raises FastPathRefusedError if their type differs."""
    if any(kind.is_float is not is_float for kind in pdo.kinds):
        raise FastPathRefusedError
    return new_slots(slots, pdo)
