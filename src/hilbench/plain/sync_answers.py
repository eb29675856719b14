"""The answers of a host's devices to a SYNC, on arrays: from the packet that the bench has sent to theirs."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.identifiers import HEARTBEAT, SYNC, NmtState
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cia402.state_machine import Command
from hilbench.plain import kernel
from hilbench.plain import layout as lay
from hilbench.plain.devices import HostFrames
from hilbench.plain.host import is_heartbeat
from hilbench.plain.packets import RECORD, Packets
from hilbench.plain.tables import Frames, NotPlainError, Slots, drive_row, table

_ENABLED = Command.ENABLE_OPERATION.value
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat
#: Bus time is the hub's: what the kernel makes of it here nobody asks for.
BITRATE = 1_000_000


class SyncAnswers:
    """Takes what comes with a SYNC, and answers it.

    `expected`: like the frames of each cycle, SYNC the last; `clock` is that of the devices; `cycle_ns`: from one SYNC
    to the next. `fill` is to be called before the first cycle.
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
        """Raises NotPlainError where cycles are not plain."""
        self._link, self._devices, self._clock, self._cycle_ns = link, devices, clock, cycle_ns
        self._cycles = 0
        if not all(drive.follows(_ENABLED) for drive in drives):
            raise NotPlainError
        if any(device.sync_cob_id != SYNC for device in devices):
            raise NotPlainError
        self.slots, self._frames = Slots(), Frames()
        for frame in expected:
            self._frames.add(frame.can_id, lay.SYNC if frame.can_id == SYNC else lay.BEFORE_SYNC, frame.data)
        if len(set(self._frames.cob_ids)) != len(expected):
            raise NotPlainError
        self._expects(expected)
        #: What the devices take, answer, and say of themselves.
        self.host = HostFrames(0, devices, drives, self._frames, self.slots, cycle_ns)
        self.host.receive()
        self._find_controlwords(drives)
        self.host.answer()
        self.drives = table([drive_row(drive, self.slots) for drive in drives], lay.DRIVE)
        self._until_ns = self.host.quiet_until_ns()

    def _expects(self, expected: Sequence[Frame]) -> None:
        """What is in the packet of a cycle, but for the bench's heartbeat, which comes before SYNC."""
        self._count = len(expected)
        self._cob_ids = tuple(frame.can_id for frame in expected)
        self._sizes = tuple(len(frame.data) for frame in expected)
        self._packets = Packets(self._link.dropped)

    def _find_controlwords(self, drives: Sequence[SimulatedDrive]) -> None:
        """Where they are in the data of a cycle's frames."""
        cells = [drive.firmware.controlword for drive in drives]
        slots = {self.slots.of_cells[id(cell)] for cell in cells if id(cell) in self.slots.of_cells}
        fields = [field for field in self._frames.received if field[1] in slots and field[4] != lay.FLOAT]
        self._controlwords = [(8 * row + offset, 8 * row + offset + width) for row, _, offset, width, _ in fields]

    def fill(self) -> None:
        """The arrays, of what has slots by now."""
        frames, slots, drives = self._frames, self.slots, self.drives
        self._rows = table(frames.rows, lay.FRAME)
        self.whole = np.array([*slots.whole, 0], np.int64)
        self.real = np.array([*slots.real, 0.0], np.float64)
        self._data = np.zeros((len(frames.rows), 8), np.uint8)
        for row, content in frames.constants.items():
            self._data[row, : len(content)] = np.frombuffer(content, np.uint8)
        self._data_at = self._data.reshape(-1).data
        self._given = np.zeros(lay.I_SIZE, np.int64)
        self._given_at = self._given.data
        self._left = np.zeros(lay.O_SIZE + len(frames.rows), np.int64)
        self._sent = self._left[lay.O_SIZE + self._count :]  # bits of each answer; 0: not its turn
        self.asked, self.shown = np.zeros(len(drives)), np.zeros(lay.PORT_SIZE * len(drives))
        answers = len(frames.rows) - self._count
        self._records = np.zeros(answers, RECORD)
        self._records["can_id"], self._records["size"] = frames.cob_ids[self._count :], frames.sizes[self._count :]
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

    def answer(self, packet: bytes) -> bool:
        """Answer what a packet asks for; False where that is not plain, and nothing was done."""
        begun_ns = time.monotonic_ns()
        if not self._still_plain(begun_ns) or not self._take(packet):
            return False
        self._given_at[lay.I_CLOCKS] = self._clock.next_ns
        if not kernel.exchange(self.table, BITRATE):
            return False
        self._clock.tick_at(begun_ns)
        self._link.send_records(self._answers())
        self._cycles += 1
        return True

    def _still_plain(self, now_ns: int) -> bool:
        if not self._clock.runs_until(now_ns, self._until_ns):
            return False
        return not any(device.outbox for device in self._devices)

    def _take(self, packet: bytes) -> bool:
        """Data of the frames that are expected; False where the packet has others."""
        packets = self._packets
        packets.begin()
        if not packets.take(packet):
            return False
        cob_ids, sizes, data = packets.cob_ids, packets.sizes, packets.data
        if len(cob_ids) == self._count + 1:
            heartbeat = cob_ids[-2]
            if not is_heartbeat(heartbeat) or sizes[-2] != 1 or data[-16:-15] != _OPERATIONAL:
                return False
            self._hear(heartbeat)
            cob_ids, sizes = cob_ids[:-2] + cob_ids[-1:], sizes[:-2] + sizes[-1:]
            data = data[:-16] + data[-8:]
        if cob_ids != self._cob_ids or sizes != self._sizes:
            return False
        for begin, end in self._controlwords:
            if int.from_bytes(data[begin:end], "little") != _ENABLED:
                return False
        self._data_at[: len(data)] = data
        return True

    def _hear(self, heartbeat: int) -> None:
        """What the host does with a heartbeat of the bench, which may come again."""
        if heartbeat == self._clock.kept_by:
            self._clock.keep()
        for device in self._devices:
            device.consumer.heard(heartbeat - HEARTBEAT)
        self._until_ns = self.host.quiet_until_ns()

    def _answers(self) -> bytes:
        """Records of those whose turn it is."""
        self._records["data"] = self._data[self._count :]
        if self._left[lay.O_FRAMES] == len(self._rows):
            return bytes(self._records)
        return bytes(self._records[self._sent != 0])

    @property
    def has_answered(self) -> bool:
        """Whether it has at all."""
        return self._cycles > 0

    def give(self) -> None:
        """The devices get what the arrays have of their PDOs and heartbeats."""
        self.host.give(self._rows, self._data, self._cycles, self._clock.next_ns - 2 * self._cycle_ns)
