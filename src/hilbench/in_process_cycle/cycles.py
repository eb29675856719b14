"""Fast path of a bench with simulated hardware and twin in its own process.

A cycle fits the *fast path* when all drives follow their set points and the wire carries only SYNC, PDOs and
heartbeats. Then no decision in it needs Python: `kernel` does it on arrays. Anything else (SDO,
NMT, EMCY, another state, a fault, a timer that runs out, a foreign frame) is for the interpreted cycle, which
is the reference: before it, and before any other use of the bus, the objects are updated from the arrays.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from hilbench.canopen.clock import SyncClock
from hilbench.canopen.identifiers import HEARTBEAT
from hilbench.cia402.state_machine import Command
from hilbench.compiled import load, table_of
from hilbench.cycle_program import CompiledStage, python_stage
from hilbench.exchange.frame_tap import FrameTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import kernel
from hilbench.fast_path.bench_cycle import STAGES, BenchFastCycle, FastPath
from hilbench.fast_path.motors import Motors
from hilbench.fast_path.tables import FastPathRefusedError, drive_row
from hilbench.in_process_cycle.wiring import InOneProcess, Wiring
from hilbench.plant.motor_port import FEEDBACK_SIZE
from hilbench.topology.sample import CycleSample
from hilbench.twin.in_arrays import TwinInArrays, give_counters

_ENABLED = Command.ENABLE_OPERATION.value


class FastPathCycles(FastPath):
    """Runs the cycles of a bench that fit the fast path, with its devices in the same process."""

    def __init__(
        self, here: InOneProcess, nodes: Nodes, sync: SyncCycle, own: MasterNode, tap: FrameTap | None
    ) -> None:
        super().__init__(nodes, sync, own)
        self._here, self._tap = here, tap
        here.bus.before_use = self.settle

    @staticmethod
    def warm_up() -> None:
        """Compile, or load from the cache, the functions called."""
        load(kernel.exchange, kernel.publish, *STAGES)

    @property
    def _locks(self) -> Sequence[AbstractContextManager[Any]]:
        return self._sync.lock, self._here.lock

    def _after(self, done: int) -> None:
        """The next cycle may fit again."""

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        if self._run is not None:
            with self._here.lock:
                super().settle()

    def _new_run(self) -> BenchFastCycle | None:
        here, served = self._here, (self._here.hardware, self._here.twin)
        if not here.bus.quiet or any(link.holds_frames for link in (here.link, *(each.link for each in served))):
            return None
        if not all(each.host.fits_fast_path for each in served):
            return None
        return _Run(here, self._nodes, self._sync, self._tap)


class _Run(BenchFastCycle):
    """Fast-path cycles in one process."""

    _wiring: Wiring

    def __init__(self, here: InOneProcess, nodes: Nodes, sync: SyncCycle, tap: FrameTap | None) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._here = here
        self._bench_drives = nodes.drives
        self._devices = (*here.hardware.devices, *here.twin.devices)
        step_s = here.rig.fast_path_step_s()
        drives = (*here.rig.drives, *here.machine.drives)
        advances_by_sync = here.machine.fits_fast_path and not here.machine.advances_by_clock
        if step_s is None or not all(drive.follows(_ENABLED) for drive in drives) or not advances_by_sync:
            raise FastPathRefusedError
        wiring = Wiring(here, nodes, sync)
        rows: list[tuple[Any, ...]] = []
        for wiring.slots.side, of_side in enumerate((here.rig.drives, here.machine.drives)):
            rows += [drive_row(drive, wiring.slots) for drive in of_side]
        wiring.slots.side = 1
        self._machine = TwinInArrays(here.machine, wiring.slots)
        super().__init__(wiring, tap, rows, wiring.received)
        self._ticked = 0
        self._join_motors(step_s)
        bitrate, exchanged = nodes.config.bus.bitrate, table_of(self._image)
        self._frames_stage = CompiledStage(kernel.exchange, bitrate, (), fallback=self._left, table=exchanged)
        self._publish = CompiledStage(kernel.publish, 0, (), fallback=self._publish_by_objects, table=exchanged)
        self._of_machine: tuple[CompiledStage | None, Sequence[CompiledStage]] = None, ()
        self._deadlines()

    def _join_motors(self, step_s: float) -> None:
        """The drives on both sides, with what they turn."""
        here, count, image = self._here, len(self._here.rig.drives), self._image
        values = image.whole, image.real
        self._hardware = Motors(
            here.rig.drives,
            image.drives[:count],
            *(*values, image.asked[:count], image.shown[: FEEDBACK_SIZE * count]),
            here.rig.rig,
            step_s,
            self._wiring.slots.cells[0],
            alone=count == len(here.rig.ports),
        )
        self._machine.join(
            image.drives[count:],
            *values,
            image.asked[count:],
            image.shown[FEEDBACK_SIZE * count :],
            image.feedback[4 * len(self._bench_drives) :],
        )

    def _deadlines(self) -> None:
        """Times, by each host's clock, until which no heartbeat consumer time-out can expire."""
        self._until_ns: list[tuple[SyncClock, int]] = []
        for served, host in zip((self._here.hardware, self._here.twin), self._wiring.hosts, strict=True):
            self._until_ns.append((served.clock, host.quiet_until_ns()))

    # -- parts of a cycle ------------------------------------------------------------------------------------

    def _fitting_cycles(self, now_ns: int) -> int:
        if self._hardware.over or self._here.bus.waiting or not self._machine.stays() or not self._is_steady:
            return 0
        for device in self._devices:
            if device.outbox:
                return 0
        if now_ns > self._sync.slow_from_ns:
            return 0
        return min(clock.syncs_until(now_ns, until_ns) for clock, until_ns in self._until_ns)

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> BenchFastCycle | None:
        status, _ = self._wiring.status
        return super().chained(sample, shown) if self._wiring.frames.every(status) == 1 else None

    def _step_hardware(self) -> None:
        self._tick_this()
        self._hardware.step()

    def _stages(self) -> Sequence[CompiledStage]:
        machine, hardware = self._machine.piece, self._hardware.step
        if not isinstance(hardware, CompiledStage):
            hardware = python_stage(self._step_hardware)
        if self._of_machine[0] is not machine:

            def fallback(code: int) -> bool:
                self._tick_this()
                return machine.fallback(code)

            step = CompiledStage(
                machine.function,
                machine.argument,
                machine.arrays,
                continues=machine.continues,
                fallback=fallback,
                table=machine.table,
            )
            stages = self._frames_stage, *self._heartbeat, hardware, step, self._publish
            self._of_machine = machine, stages
        return self._of_machine[1]

    def _left(self, _: int) -> bool:
        self._leave()
        return False

    def _set_times(self) -> None:
        super()._set_times()
        self._image.clocks[:] = self._here.hardware.clock.next_ns, self._here.twin.clock.next_ns

    def _send_heartbeat(self, _: int) -> bool:
        self._tick(time.monotonic_ns(), int(self._totals[0]["cycles"]))
        sender = self._wiring.frames.cob_ids[self._wiring.own_heartbeat] - HEARTBEAT
        for device in self._devices:
            device.consumer.received(sender)
        self._deadlines()
        return super()._send_heartbeat(0)

    def _tick(self, now_ns: int, syncs: int) -> None:
        """Advance the clocks of hardware and twin to `syncs` SYNCs since this run began."""
        for served in (self._here.hardware, self._here.twin):
            served.clock.tick_at(now_ns, syncs - self._ticked)
        self._ticked = syncs

    def _publish_by_objects(self, _: int) -> bool:
        self._tick_this()
        self._hardware.publish_by_objects()
        self._machine.publish_by_objects()
        return False

    def _tick_this(self) -> None:
        """The SYNC of the cycle that is not counted yet was on the wire."""
        self._tick(time.monotonic_ns(), int(self._totals[0]["cycles"]) + 1)

    def _account(self, frames: int, bits: int, duration_ns: int, begun_ns: int) -> None:
        self._here.bus.account(frames, bits, duration_ns)
        self._tick(begun_ns, int(self._totals[0]["cycles"]))

    # -- back to the objects ---------------------------------------------------------------------------------

    def end(self) -> None:
        """As of `BenchFastCycle`; the twin's machine goes back to its objects also where no cycle was run."""
        super().end()
        self._here.machine.forget_vectors()

    def _give(self) -> None:
        """Update both sides from the last PDOs and heartbeats."""
        here = self._here
        self._hardware.give()
        self._machine.give()
        for served, host in zip((here.hardware, here.twin), self._wiring.hosts, strict=True):
            received_ns = served.clock.next_ns - 2 * self._nodes.config.cycle_ns
            host.give(self._image, self.done, received_ns)
        give_counters(here.machine.listeners, self._image.seen[len(self._bench_drives) :])
        now_s = time.monotonic()
        for served in (here.hardware, here.twin):
            served.host.served_until(now_s)
