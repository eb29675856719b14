"""Answers of a host's devices to a SYNC, on arrays: from the bench's packet to theirs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilbench.can import protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.identifiers import HEARTBEAT, SYNC
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cia402.state_machine import Command
from hilbench.fast_path import kernel, packet_kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.devices import HostFrames
from hilbench.fast_path.packet_kernel import ANSWERED, NOTHING, OTHER
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots, drive_row, table

_ENABLED = Command.ENABLE_OPERATION.value


class SyncAnswers:
    """Takes the frames of a SYNC in one packet, and answers it.

    `clock`: that of the devices; `expected`: like the frames of each cycle, SYNC the last; `cycle_ns`: from one SYNC to
    the next. `fill` is to be called before the first cycle.
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
        self._cycles = 0
        self.came: Sequence[bytes] = ()  #: packets for the host
        self.received = packet_kernel.buffer()
        if not all(drive.follows(_ENABLED) for drive in drives):
            raise FastPathRefusedError
        if any(device.sync_cob_id != SYNC for device in devices):
            raise FastPathRefusedError
        self.slots, self._frames = Slots(), Frames()
        for frame in expected:
            self._frames.add(frame.can_id, lay.SYNC if frame.can_id == SYNC else lay.BEFORE_SYNC, frame.data)
        if len(set(self._frames.cob_ids)) != len(expected):
            raise FastPathRefusedError
        self._count = len(expected)
        #: RPDOs, TPDOs and heartbeats of the devices.
        self.host = HostFrames(0, devices, drives, self._frames, self.slots, cycle_ns)
        self.host.receive()
        self._checks = self._controlwords(drives)
        self.host.answer()
        self.drives = table([drive_row(drive, self.slots) for drive in drives], lay.DRIVE)
        self._until_ns = self.host.quiet_until_ns()

    def _controlwords(self, drives: Sequence[SimulatedDrive]) -> list[tuple[int, ...]]:
        """Checks (see `packet_kernel.Port`) that the controlwords stay ENABLE OPERATION."""
        cells = [drive.firmware.controlword for drive in drives]
        slots = {self.slots.of_cells[id(cell)] for cell in cells if id(cell) in self.slots.of_cells}
        fields = [field for field in self._frames.received if field[1] in slots and field[4] != lay.FLOAT]
        return [(row, offset, width, (1 << 8 * width) - 1, _ENABLED) for row, _, offset, width, _ in fields]

    def fill(self) -> None:
        """The arrays, of what has slots by now."""
        frames, slots, drives = self._frames, self.slots, self.drives
        self._rows = table(frames.rows, lay.FRAME)
        self.whole = np.array([*slots.whole, 0], np.int64)
        self.real = np.array([*slots.real, 0.0], np.float64)
        self._data = np.zeros((len(frames.rows), 8), np.uint8)
        for row, content in frames.constants.items():
            self._data[row, : len(content)] = np.frombuffer(content, np.uint8)
        self._given = np.zeros(lay.I_SIZE, np.int64)
        self._given_at = self._given.data
        self._left = np.zeros(lay.O_SIZE + len(frames.rows), np.int64)
        self.asked, self.shown = np.zeros(len(drives)), np.zeros(lay.PORT_SIZE * len(drives))
        self._vectors = kernel.Vectors(
            frames=self._rows,
            sent=table(frames.sent, lay.FIELD),
            received=table(sorted(frames.received), lay.FIELD),
            drives=drives,
            whole=self.whole,
            real=self.real,
            given=self._given,
            left=self._left,
            data=self._data.reshape(-1),
            asked=self.asked,
            shown=self.shown,
        )
        self.table = self._vectors.table()
        wire = np.column_stack((frames.cob_ids, frames.sizes)).astype(np.int64)
        self._port = packet_kernel.new_port(
            self._link.fileno(),
            self._link.dropped,
            wire[: self._count].copy(),
            np.array(self._checks, np.int64).reshape((-1, 5)),
            wire[self._count :].copy(),
            self._left,
            self._data.reshape(-1),
            self.received,
        )
        self._port_table, self._numbers = self._port.table(), self._port.numbers.data

    def _send_again(self) -> None:
        """Send again the answers that the bus did not take."""
        at, end = protocol.HEADER.size, self._numbers[packet_kernel.OUT_LENGTH]
        self._link.send_records(self._port.sent[at:end].tobytes())

    def _hear(self, heartbeat: int) -> None:
        """Consume a heartbeat of the bench as the host does; it may come again."""
        if heartbeat == self._clock.kept_by:
            self._clock.keep()
            self._numbers[packet_kernel.UNTIL_NS] = self._clock.stalls_at_ns
        for device in self._devices:
            device.consumer.received(heartbeat - HEARTBEAT)
        self._until_ns = self.host.quiet_until_ns()

    @property
    def _is_due(self) -> bool:
        """True if a device has to send, or notice, something by itself with the next SYNC."""
        return self._clock.next_ns > self._until_ns or any(device.outbox for device in self._devices)

    @property
    def cycles(self) -> int:
        """SYNCs that were answered."""
        return self._cycles

    def serve(self, timeout_s: float) -> int:
        """Answer the next packet: ANSWERED; NOTHING: none came within the time; OTHER: it, or what is due, does not
        fit the fast path, and nothing was done: it is in `came`."""
        clock, numbers = self._clock, self._numbers
        if self._is_due:
            return self._leave(timeout_s)
        self._given_at[lay.I_CLOCKS] = clock.next_ns
        numbers[packet_kernel.UNTIL_NS] = clock.stalls_at_ns
        outcome = packet_kernel.answer(self.table, self._port_table, packet_kernel.RECEIVE)
        if outcome != ANSWERED:
            outcome = self._see_to(outcome, timeout_s)
            if outcome != ANSWERED:
                return outcome
        clock.tick_at(numbers[packet_kernel.NOW_NS])
        self._cycles += 1
        return ANSWERED

    def _leave(self, timeout_s: float) -> int:
        packet = self._link.receive_packet(timeout_s)
        self.came = () if packet is None else (packet,)
        return NOTHING if packet is None else OTHER

    def _see_to(self, outcome: int, timeout_s: float) -> int:
        """Handle the rare outcomes: wait for a packet, a heartbeat, answers that were not taken."""
        numbers, tables = self._numbers, (self.table, self._port_table)
        if outcome == NOTHING:
            packet = self._link.receive_packet(timeout_s)
            if packet is None:
                return NOTHING
            self.received[: len(packet)] = np.frombuffer(packet, np.uint8)
            numbers[packet_kernel.LENGTH] = len(packet)
            outcome = packet_kernel.answer(*tables, packet_kernel.TAKEN)
        if outcome == packet_kernel.ALIVE:
            self._hear(numbers[packet_kernel.HEARTBEAT_OF])
            outcome = OTHER if self._is_due else packet_kernel.answer(*tables, packet_kernel.RECEIVED)
        if outcome == packet_kernel.UNSENT:
            self._send_again()
            outcome = ANSWERED
        if outcome == OTHER:
            self.came = (self.received[: numbers[packet_kernel.LENGTH]].tobytes(),)
        return outcome

    @property
    def is_active(self) -> bool:
        """True if SYNC has stopped."""
        return self._clock.stalled_ns() > 0

    def give(self) -> None:
        """The devices get what the arrays have of their PDOs and heartbeats."""
        received_ns = self._clock.next_ns - 2 * self._cycle_ns  # the last RPDOs
        self.host.give(self._rows, self._data, self._cycles, received_ns)
