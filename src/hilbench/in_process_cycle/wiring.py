"""The frames of a fast-path cycle, made from the objects of bench and devices: senders, contents,
receivers."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hilbench.can.memory import MemoryBus, MemoryLink
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.identifiers import SYNC
from hilbench.canopen.pdo import PdoMap
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle
from hilbench.fast_path.bench import BenchFrames, DriveFeedback, new_slots_of_kind
from hilbench.fast_path.devices import HostFrames
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots, new_slots
from hilbench.hardware.simulation import RigApplication
from hilbench.twin.in_arrays import received_row
from hilbench.twin.process import TwinApplication


@dataclass(frozen=True)
class Served:
    """The devices of one host, as they are on the bus of a process."""

    host: DeviceHost
    link: MemoryLink
    devices: Sequence[Device]
    clock: SyncClock


@dataclass(frozen=True)
class InOneProcess:
    """Participants in one process and the bus in memory: `link` is the bench's."""

    bus: MemoryBus
    link: MemoryLink
    lock: threading.RLock
    hardware: Served
    rig: RigApplication
    twin: Served
    machine: TwinApplication


class Wiring:
    """Frames of each fast-path cycle, and the slots of their values."""

    def __init__(self, here: InOneProcess, nodes: Nodes, sync: SyncCycle) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._here, self._nodes, self._sync = here, nodes, sync
        self.slots, self.frames = Slots(), Frames()
        #: Frames sent by the bench.
        self.bench = BenchFrames(nodes, sync, self.frames, self.slots)
        self._behind_sync = len(self.frames.rows)
        #: Axis feedback that the twin receives: rows of `layout.FEEDBACK`, and where it is after that of the
        #: drives that the bench sees.
        self.received: list[tuple[Any, ...]] = []
        self.received_axes: list[int] = []
        #: Values that the bench takes from the virtual I/O's TPDOs: rows of `layout.VIRTUAL_IO`; the row of its status,
        #: and where that is among the whole numbers.
        self.virtual_io_rows: list[tuple[int, int, int, int]] = []
        self.status: tuple[int, slice] = (-1, slice(0))
        self._check_listeners()
        drives = (*here.rig.drives, *here.machine.drives)
        cycle_ns = nodes.config.cycle_ns
        #: Hardware and twin: RPDOs, TPDOs and heartbeats of their devices.
        self.hosts = [
            HostFrames(side, served.devices, drives, self.frames, self.slots, cycle_ns)
            for side, served in enumerate((here.hardware, here.twin))
        ]
        for host in self.hosts:
            host.receive()
        for host in self.hosts:
            host.answer()
        self._check_answers()
        self._see()
        self._check_phases()

    def _check_listeners(self) -> None:
        """Check that only the hosts receive the bench's frames."""
        hosts = (self._here.hardware, self._here.twin)
        for cob_id in self.frames.cob_ids:
            links = self._here.bus.hear(cob_id)
            if any(link not in (self._here.link, hosts[0].link, hosts[1].link) for link in links):
                raise FastPathRefusedError
        if any(device.sync_cob_id != SYNC for served in hosts for device in served.devices):
            raise FastPathRefusedError

    def _check_answers(self) -> None:
        """Check that only the bench and the twin's application receive the answers."""
        frames, here = self.frames, self._here
        for row in range(self._behind_sync, len(frames.rows)):
            cob_id = frames.cob_ids[row]
            links = here.bus.hear(cob_id)
            known = (here.link, here.hardware.link, here.twin.link)
            if here.link not in links or any(link not in known for link in links):
                raise FastPathRefusedError
            if here.hardware.host.addressees(cob_id) or here.twin.host.addressees(cob_id):
                raise FastPathRefusedError

    def _see(self) -> None:
        """Enter the feedback that the bench takes from the drives, and the twin from the axes."""
        frames, slots = self.frames, self.slots
        #: Feedback of each drive to the bench.
        self.seen = DriveFeedback(self._nodes, slots)
        for pdo, taken in self.seen.taken:
            frames.take(frames.row_of(pdo.cob_id), pdo, taken)
        row, first, last = self._receive_pdo(self._nodes.io.status, is_float=False)
        self.status = row, slice(first, last)
        for pdo, part in zip(self._nodes.io.sent, self._nodes.measured.parts, strict=True):
            self.virtual_io_rows.append((*self._receive_pdo(pdo, is_float=True), part.start))
        for listener in self._here.machine.listeners:
            row, taken = frames.row_of(listener.cob_id), new_slots(slots, listener.pdo)
            if row < self._behind_sync or frames.rows[row][4] != 1:
                raise FastPathRefusedError
            frames.take(row, listener.pdo, taken)
            self.received_axes.append(4 * (len(self.seen.raw) + len(self.received)))
            self.received.append(received_row(listener, taken[listener.position], taken[listener.torque]))

    def _receive_pdo(self, pdo: PdoMap, *, is_float: bool) -> tuple[int, int, int]:
        """Enter a TPDO of the virtual I/O that the bench takes: row, first slot, end of the slots."""
        row, taken = self.frames.row_of(pdo.cob_id), new_slots_of_kind(pdo, self.slots, is_float=is_float)
        self.frames.take(row, pdo, taken)
        return row, taken[0], taken[-1] + 1

    def _check_phases(self) -> None:
        """Check that the TPDOs that the bench expects are those that the nodes send, in phase."""
        cycles, frames = self._sync.timing.cycles, self.frames
        sent = {frames.cob_ids[row]: (row, tpdo) for host in self.hosts for _, tpdo, row in host.answering}
        expected: list[ExpectedPdo] = [*self._sync.due_always.values(), *self._sync.due_at_times]
        for pdo in expected:
            if pdo.cob_id not in sent:
                raise FastPathRefusedError
            row, tpdo = sent[pdo.cob_id]
            if tpdo.transmission_type != pdo.every or pdo.size not in (None, frames.sizes[row]):
                raise FastPathRefusedError
            if (cycles + pdo.every - tpdo.syncs - pdo.since) % pdo.every:
                raise FastPathRefusedError
        if {pdo.cob_id for pdo in expected} != set(self._nodes.answers):
            raise FastPathRefusedError
        for cob_id, answer in self._nodes.answers.items():
            row, tpdo = sent[cob_id]
            if answer.size != frames.sizes[row] or answer.every != tpdo.transmission_type:
                raise FastPathRefusedError
            if answer.every != 1 and answer.since != tpdo.syncs and answer.since < answer.every:
                raise FastPathRefusedError
