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
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle
from hilbench.fast_path.bench_cycle import BenchFrames
from hilbench.fast_path.host_cycle import HostFrames
from hilbench.fast_path.tables import new_slots, refuse_if
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


class Wiring(BenchFrames):
    """Frames of each fast-path cycle, and the slots of their values.

    `hosts`: hardware and twin: RPDOs, TPDOs and heartbeats of their devices; `received`: rows of `layout.FEEDBACK` for
    what the twin receives of the axes.
    """

    def __init__(self, here: InOneProcess, nodes: Nodes, sync: SyncCycle) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._here = here
        super().__init__(nodes, sync)
        self.received: list[tuple[Any, ...]] = []
        for listener in here.machine.listeners:
            row, taken = self.frames.row_of(listener.cob_id), new_slots(self.slots, listener.pdo)
            refuse_if(row < self.asked or self.frames.every(row) != 1)
            self.frames.take(row, listener.pdo, taken)
            self.received.append(received_row(listener, taken[listener.position], taken[listener.torque]))
        self._check_phases()

    def answer(self) -> None:
        """Add the answers of the hosts."""
        here = self._here
        drives = (*here.rig.drives, *here.machine.drives)
        cycle_ns = self.nodes.config.cycle_ns
        self.hosts = [
            HostFrames(side, served.devices, drives, self.frames, self.slots, cycle_ns)
            for side, served in enumerate((here.hardware, here.twin))
        ]
        for host in self.hosts:
            host.receive()
        for host in self.hosts:
            host.answer()
        self.heartbeats = [(device.node_id, row) for host in self.hosts for device, row in host.heartbeats]
        self._check_receivers()

    def _check_receivers(self) -> None:
        """Check that only bench and hosts receive frames, and of answers only the bench and the twin's application."""
        here, hosts = self._here, (self._here.hardware, self._here.twin)
        for row, cob_id in enumerate(self.frames.cob_ids):
            links = here.bus.hear(cob_id)
            refuse_if(any(link not in (here.link, hosts[0].link, hosts[1].link) for link in links))
            is_answer = row >= self.asked
            refuse_if(is_answer and (here.link not in links or any(served.host.addressees(cob_id) for served in hosts)))
        refuse_if(any(device.sync_cob_id != SYNC for served in hosts for device in served.devices))

    def _check_phases(self) -> None:
        """Check that the TPDOs that the bench expects are those that the nodes send, in phase."""
        cycles, frames = self.sync.timing.cycles, self.frames
        sent = {frames.cob_ids[row]: (row, tpdo) for host in self.hosts for _, tpdo, row in host.answering}
        expected: list[ExpectedPdo] = [*self.sync.due_always.values(), *self.sync.due_at_times]
        for pdo in expected:
            refuse_if(pdo.cob_id not in sent)
            row, tpdo = sent[pdo.cob_id]
            refuse_if(tpdo.transmission_type != pdo.every or pdo.size not in (None, frames.sizes[row]))
            refuse_if((cycles + pdo.every - tpdo.syncs - pdo.since) % pdo.every)
        refuse_if({pdo.cob_id for pdo in expected} != set(self.nodes.answers))
        for cob_id, answer in self.nodes.answers.items():
            row, tpdo = sent[cob_id]
            refuse_if(answer.size != frames.sizes[row] or answer.every != tpdo.transmission_type)
            refuse_if(answer.every != 1 and answer.since != tpdo.syncs and answer.since < answer.every)
