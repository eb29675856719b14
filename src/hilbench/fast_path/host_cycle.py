"""Fast-path cycles of the devices of a host, on arrays: the frames of a SYNC from packets, and their answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.device_pdo import Rpdo, Tpdo
from hilbench.canopen.identifiers import HEARTBEAT, SYNC, NmtState
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cia402.state_machine import Command
from hilbench.compiled import table_of
from hilbench.cycle_program import CONTINUE
from hilbench.fast_path import kernel, packet_kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.motors import Motors
from hilbench.fast_path.packet_kernel import BITRATE, NOTHING, OTHER, UNSENT, PacketPort
from hilbench.fast_path.tables import (
    FastPathRefusedError,
    Frames,
    Slots,
    cell_slots,
    drive_row,
    new_image,
    refuse_if,
    sent_data,
)
from hilbench.plant.interface import Steps


class HostFrames:
    """RPDOs, heartbeats and synchronous TPDOs of the devices of one host, each with its row among the frames.

    `side`: place of the host among those whose cells have slots, and of its clock among those that a cycle is given;
    `drives`: whose controlwords may be written in each cycle, as long as they are the same; `cycle_ns`: from one SYNC
    to the next.
    """

    def __init__(
        self,
        side: int,
        devices: Sequence[Device],
        drives: Sequence[SimulatedDrive],
        frames: Frames,
        slots: Slots,
        cycle_ns: int,
    ) -> None:
        self.taken: list[tuple[Device, Rpdo, int]] = []
        self.answering: list[tuple[Device, Tpdo, int]] = []
        self.heartbeats: list[tuple[Device, int]] = []
        self._side, self._devices, self._frames, self._slots, self._cycle_ns = side, devices, frames, slots, cycle_ns
        self._controlwords = [drive.firmware.controlword for drive in drives]

    def receive(self) -> None:
        """Enter the RPDOs that the devices take from the frames so far. Each value of a drive except its controlword
        must be one without side effect. Raises FastPathRefusedError."""
        self._slots.side = self._side
        for device in self._devices:
            for cob_id, rpdo in device.receive_pdos.items():
                self._receive(device, cob_id, rpdo)

    def _receive(self, device: Device, cob_id: int, rpdo: Rpdo) -> None:
        if cob_id not in self._frames.cob_ids:
            refuse_if(not rpdo.idle)
            return
        if not rpdo.fits_fast_path(self._cycle_ns) or rpdo.map is None:
            raise FastPathRefusedError
        refuse_if(any(cell.on_write is not None and cell not in self._controlwords for cell in rpdo.cells))
        row = self._frames.row_of(cob_id)
        self._frames.take(row, rpdo.map, cell_slots(self._slots, rpdo.map, rpdo.cells))
        self.taken.append((device, rpdo, row))

    def answer(self) -> None:
        """Enter the devices' heartbeats and TPDOs after the frames so far. Raises FastPathRefusedError."""
        self._slots.side = self._side
        for device in self._devices:
            self._send_heartbeat(device)
            for tpdo in device.synchronous_pdos:
                if tpdo.map is None:
                    raise FastPathRefusedError
                slots, every = cell_slots(self._slots, tpdo.map, tpdo.cells), tpdo.transmission_type
                row = self._frames.add(tpdo.cob_id, lay.ANSWER, tpdo.map, slots, every=every, count=tpdo.syncs)
                self.answering.append((device, tpdo, row))

    def _send_heartbeat(self, device: Device) -> None:
        producer = device.producer
        if producer.period_ns:
            row = self._frames.add(
                HEARTBEAT + device.node_id,
                lay.ANSWER,
                NmtState.OPERATIONAL.heartbeat,
                timing=lay.BY_TIME,
                period_ns=producer.period_ns,
                next_ns=producer.next_ns,
                clock=self._side,
            )
            self.heartbeats.append((device, row))

    def quiet_until_ns(self) -> int:
        """Time until which no heartbeat consumer time-out of the devices can expire."""
        ends = [device.consumer.quiet_until_ns() for device in self._devices]
        return min((end for end in ends if end is not None), default=1 << 62)

    def give(self, image: kernel.Image, cycles: int, received_ns: int) -> None:
        """Update the devices after so many cycles: the last RPDOs came at `received_ns`."""
        for _, rpdo, _ in self.taken:
            rpdo.received_until(received_ns)
        for device, row in self.heartbeats:
            device.producer.sent_until(int(image.frames[row]["next_ns"]))
        for _, tpdo, row in self.answering:
            count = int(image.frames[row]["count"])
            tpdo.sent_until(count, sent_data(image, row, self._frames.sizes[row]) if count < cycles else None)


_ENABLED = Command.ENABLE_OPERATION.value
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat


class SyncAnswers:
    """Takes the frames of a SYNC, and answers it.

    `clock`: that of the devices; `expected`: like the frames of each cycle, SYNC the last; `cycle_ns`: from one SYNC to
    the next. `frames` and `slots` may get more before `fill`, which is called before the first cycle.
    """

    def __init__(
        self,
        link: EmbeddedLink,
        devices: Sequence[Device],
        drives: Sequence[SimulatedDrive],
        clock: SyncClock,
        expected: Sequence[Frame],
        cycle_ns: int,
    ) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._link, self._devices, self._clock, self._cycle_ns = link, devices, clock, cycle_ns
        self.cycles = 0  #: SYNCs that were answered
        self._late: list[bytes] = []  # packets not put into the port
        refuse_if(not all(drive.follows(_ENABLED) for drive in drives))
        refuse_if(any(device.sync_cob_id != SYNC for device in devices))
        self.slots, self.frames = Slots(), Frames()
        for frame in expected:
            self.frames.add(frame.can_id, lay.SYNC if frame.can_id == SYNC else lay.BEFORE_SYNC, frame.data)
        refuse_if(len(set(self.frames.cob_ids)) != len(expected))
        self._heartbeat = -1  # row of that of the bench
        if clock.kept_by is not None:
            self._heartbeat = self.frames.add(clock.kept_by, lay.BEFORE_SYNC, _OPERATIONAL, timing=lay.BY_ARRIVAL)
        asked = len(self.frames.rows)
        #: RPDOs, TPDOs and heartbeats of the devices.
        self.host = HostFrames(0, devices, drives, self.frames, self.slots, cycle_ns)
        self.host.receive()
        self._checks = self._controlwords(drives)
        self.host.answer()
        self._ends = asked, len(self.frames.rows)
        self._drives = [drive_row(drive, self.slots) for drive in drives]
        self._until_ns = self.host.quiet_until_ns()

    def _controlwords(self, drives: Sequence[SimulatedDrive]) -> list[tuple[int, ...]]:
        """Checks (`packet_kernel.CHECK`) that the controlwords stay ENABLE OPERATION, and the bench OPERATIONAL."""
        cells = [drive.firmware.controlword for drive in drives]
        slots = {self.slots.of_cells[id(cell)] for cell in cells if id(cell) in self.slots.of_cells}
        fields = [field for field in self.frames.received if field[1] in slots and field[4] != lay.FLOAT]
        checks: list[tuple[int, ...]] = [
            (row, offset, width, (1 << 8 * width) - 1, _ENABLED) for row, _, offset, width, _ in fields
        ]
        return checks if self._heartbeat < 0 else [*checks, (self._heartbeat, 0, 1, 0xFF, _OPERATIONAL[0])]

    def fill(self, seen: Sequence[tuple[Any, ...]] = ()) -> None:
        """The image, of what has slots and frames by now, with these rows of `layout.FEEDBACK`."""
        self.image = new_image(self.frames, self.slots, drives=self._drives, seen=seen)
        self.table = table_of(self.image)
        self._port = PacketPort(self.image, self._link.fileno(), self._link.dropped, *self._ends, self._checks)

    @property
    def came(self) -> Sequence[bytes]:
        """Packets that were not answered."""
        return [*self._port.packets, *self._late]

    @property
    def _is_due(self) -> bool:
        """True if a device has to send, or notice, something by itself with the next SYNC."""
        return self._clock.next_ns > self._until_ns or any(device.outbox for device in self._devices)

    def serve(self, timeout_s: float) -> int:
        """Answer the next SYNC: CONTINUE; NOTHING: it did not come within the time; OTHER: it, or what is due, does not
        fit the fast path, and nothing was done."""
        clock, state = self._clock, self._port.state
        if self._is_due:
            packet = self._link.receive_packet(timeout_s)
            self._late += [] if packet is None else [packet]
            return NOTHING if packet is None else OTHER
        self.image.clocks[0] = clock.next_ns
        state["until_ns"] = clock.stalls_at_ns
        outcome = self.receive(packet_kernel.answer, timeout_s)
        if outcome == UNSENT:
            self._link.send_records(self._port.unsent)
        elif outcome != CONTINUE:
            return outcome
        if self._heartbeat >= 0 and self.image.frames[self._heartbeat]["bits_on_wire"]:
            self._take_heartbeat()
        clock.tick_at(int(state["now_ns"]))
        self.cycles += 1
        return CONTINUE

    def receive(self, function: Callable[[int, lay.Whole], int], timeout_s: float) -> int:
        """Run `packet_kernel.answer` or `hear` with the packets that come within a time; its outcome."""
        while (outcome := function(BITRATE, self._port.table)) == NOTHING:
            packet = self._link.receive_packet(timeout_s)
            if packet is None:
                break
            self._port.put(packet)
        return outcome

    def _take_heartbeat(self) -> None:
        """Consume a heartbeat of the bench as the host does."""
        self._clock.keep()
        for device in self._devices:
            device.consumer.received(self.frames.cob_ids[self._heartbeat] - HEARTBEAT)
        self._until_ns = self.host.quiet_until_ns()

    @property
    def is_active(self) -> bool:
        """True if SYNC has stopped."""
        return self._clock.stalled_ns() > 0

    def give(self) -> None:
        """The devices get what the arrays have of their PDOs and heartbeats."""
        received_ns = self._clock.next_ns - 2 * self._cycle_ns  # the last RPDOs
        self.host.give(self.image, self.cycles, received_ns)


class Rig(Protocol):
    """Rig application of the drives."""

    @property
    def drives(self) -> Sequence[SimulatedDrive]:
        """The simulated ones."""

    @property
    def ports(self) -> Sequence[Any]:
        """Ports of all motors, simulated drive or not."""

    @property
    def rig(self) -> Steps:
        """Mechanics that the motors turn."""

    def fast_path_step_s(self) -> float | None:
        """Step of the rig per SYNC in s; None where it is not fixed in advance."""


class RigFastCycle:
    """Fast-path run of a host with a rig (`host.PacketRun`)."""

    def __init__(self, answers: SyncAnswers, rig: Rig) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        step_s = rig.fast_path_step_s()
        if step_s is None:
            raise FastPathRefusedError
        answers.fill()
        self._answers, image = answers, answers.image
        self._motors = Motors(
            rig.drives,
            *(image.drives, image.whole, image.real, image.asked, image.shown),
            rig.rig,
            step_s,
            answers.slots.cells[0],
            alone=len(rig.drives) == len(rig.ports),
        )

    @property
    def came(self) -> Sequence[bytes]:
        """Packets left for the host."""
        return self._answers.came

    def serve(self, timeout_s: float) -> bool:
        """Answer the next SYNC (`host.PacketRun.serve`), then step the rig."""
        if self._motors.over:
            return False
        outcome = self._answers.serve(timeout_s)
        if outcome != CONTINUE:
            return outcome == NOTHING and not self._answers.is_active
        self._motors.step()
        if kernel.publish(0, self._answers.table) != CONTINUE:
            self._motors.publish_by_objects()
        return True

    def end(self) -> None:
        """Hand the state back to the objects."""
        if self._answers.cycles:
            self._motors.give()
            self._answers.give()
