"""Simulated hardware and twin inside the bench's own process: the same devices and frames, on a bus in memory.

Nothing runs in parallel: the devices are served whenever the bench looks for frames or has sent a request. In lockstep
that changes no value: each participant acts on SYNC and on the frames it receives, whichever code calls it. In real
time SYNC is paced by the clock and the devices by SYNC: no answer is late, and a missed cycle is one of the clock, not
of the devices.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import can
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus, MemoryCanBus, MemoryLink
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.host import DeviceHost
from hilbench.exchange.frame_tap import FrameTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.hardware.simulation import RigApplication, hardware, warm_up_in_modes
from hilbench.in_process_cycle.cycles import FastPathCycles
from hilbench.in_process_cycle.wiring import InOneProcess, Served
from hilbench.topology.config import BenchConfig
from hilbench.twin.process import TwinApplication, twin

MakeFastPathCycles = Callable[[SyncCycle, MasterNode], FastPathCycles | None]
#: Period of serving the devices while nothing is sent: their timers run by the wall clock then.
_IDLE_S = 0.001


class InProcess:
    """The bus of one bench with its devices on it; its links may be used from several threads."""

    def __init__(self, config: BenchConfig) -> None:
        self.bus = MemoryBus(config.bus_address.channel, config.bus.bitrate)
        self._lock = threading.RLock()
        FastPathCycles.warm_up()
        warm_up_in_modes(config)
        by_sync = config.model_copy(update={"pace": "lockstep"})
        self._hosted = hardware(by_sync), twin(by_sync)
        self._links = [self.bus.open_link() for _ in self._hosted]
        self._own_hosts = [DeviceHost(link, *hosted) for link, hosted in zip(self._links, self._hosted, strict=True)]
        self._hosts = list(self._own_hosts)

    def boot(self) -> None:
        """Let the devices send boot-up."""
        with self._lock:
            for host in self._hosts:
                host.boot()

    def serve(self) -> None:
        """Let the devices handle what they have received."""
        with self._lock:
            for host in self._hosts:
                host.serve(0.0)

    def fast_path_cycles(self, link: ServingLink, nodes: Nodes, tap: FrameTap | None) -> MakeFastPathCycles:
        """Factory for `Exchange.use`: fast-path cycles of the bench that has this link."""
        rig, machine = (hosted.application for hosted in self._hosted)

        def make(sync: SyncCycle, own: MasterNode) -> FastPathCycles | None:
            served = [
                Served(host, station, hosted.devices, hosted.clock)
                for host, station, hosted in zip(self._own_hosts, self._links, self._hosted, strict=True)
                if isinstance(hosted.clock, SyncClock)
            ]
            if len(served) < 2 or type(link) is not ServingLink:  # one of another kind has to see its frames
                return None
            if not (isinstance(rig, RigApplication) and isinstance(machine, TwinApplication)):
                return None
            here = InOneProcess(self.bus, link, self._lock, served[0], rig, served[1], machine)
            return FastPathCycles(here, nodes, sync, own, tap)

        return make

    def open_link(self) -> ServingLink:
        """The bench's link for the cyclic path."""
        return ServingLink(self)

    def open_python_can(self) -> can.BusABC:
        """The bench's bus for configuration traffic: what is sent is answered before `send` returns."""
        return _ServingCanBus(self)


class ServingLink(MemoryLink):
    """A link that serves the devices when frames are received from it."""

    def __init__(self, participants: InProcess) -> None:
        self._participants = participants
        super().__init__(participants.bus)

    def receive(self, timeout_s: float) -> list[Frame]:
        if timeout_s > 0.0 or self._participants.bus.waiting:
            self._participants.serve()
        frames = super().receive(0.0)
        if frames or timeout_s <= 0.0:
            return frames
        deadline_s = time.monotonic() + timeout_s
        while not frames and time.monotonic() < deadline_s:
            frames = super().receive(_IDLE_S)
            self._participants.serve()
        return frames


class _ServingCanBus(MemoryCanBus):
    """A python-can bus that serves the devices after each message."""

    def __init__(self, participants: InProcess) -> None:
        self._participants = participants
        super().__init__(participants.bus)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        super().send(msg, timeout)
        self._participants.serve()
