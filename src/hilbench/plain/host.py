"""Plain cycles of a process that holds simulated drives on the embedded bus: packets in, packets out, on arrays.

What came with the last SYNC is what is expected with the next one: the same frames in the same order, controlwords that
leave the drives enabled, now and then the bench's heartbeat. Then `kernel` does the work of the devices. Whatever else
comes, or is due, is for the host, which is the reference: before it the objects get back what the arrays have.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, SYNC, NmtState
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cia402.state_machine import Command
from hilbench.plain import kernel
from hilbench.plain import layout as lay
from hilbench.plain.devices import HostFrames
from hilbench.plain.motors import Motors
from hilbench.plain.packets import RECORD, Packets
from hilbench.plain.tables import Frames, NotPlainError, Slots, drive_row, table
from hilbench.plant.interface import Steps

#: Times that it is served after which it is looked anew whether cycles are plain, when they were not.
_LOOK_AGAIN = 8
_ENABLED = Command.ENABLE_OPERATION.value
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat
#: Bus time is the hub's: what the kernel makes of it here nobody asks for.
_BITRATE = 1_000_000


class Rig(Protocol):
    """What stands behind the drives."""

    @property
    def drives(self) -> Sequence[SimulatedDrive]:
        """The simulated ones."""

    @property
    def ports(self) -> Sequence[Any]:
        """Those of all motors, simulated drive or not."""

    @property
    def rig(self) -> Steps:
        """What the motors turn."""

    def plain_step_s(self) -> float | None:
        """How far the rig goes with each SYNC, in one step; None where that is not known before."""


class PlainHost:
    """Serves the devices of a host, by packets where its cycles are plain.

    `clock` is that of the devices; `cycle_ns`: from one SYNC to the next.
    """

    def __init__(
        self,
        host: DeviceHost,
        link: EmbeddedLink,
        devices: Sequence[Device],
        clock: SyncClock,
        rig: Rig,
        cycle_ns: int,
    ) -> None:
        kernel.warm_up()
        self._host, self._link, self._clock = host, link, clock
        self._devices, self._rig, self._cycle_ns = devices, rig, cycle_ns
        self._run: _Run | None = None
        self._wait = 0  # times served until it is looked again

    def serve(self, timeout_s: float) -> None:
        """As `DeviceHost.serve`."""
        packet = self._link.receive_packet(timeout_s)
        if self._run is not None:
            if self._clock.stalled_ns() == 0 if packet is None else self._run.cycle(packet):
                return
            self.settle()
        frames = self._link.frames_from(packet)
        self._host.handle(frames)
        if self._wait:
            self._wait -= 1
        elif frames:
            self._begin(frames)
            self._wait = _LOOK_AGAIN

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        run, self._run = self._run, None
        if run is not None:
            run.end()
            self._host.served_until(time.monotonic())

    def _begin(self, frames: Sequence[Frame]) -> None:
        """From the next packet on, where it can be like these frames."""
        known = [frame for frame in frames if not _is_heartbeat(frame.can_id)]
        syncs = [frame.can_id for frame in known].count(SYNC)
        if not self._host.is_plain or syncs != 1 or known[-1].can_id != SYNC:
            return
        try:
            self._run = _Run(self._link, self._devices, self._clock, self._rig, known, self._cycle_ns)
        except NotPlainError:
            return


class _Run:
    """Plain cycles one after the other, from objects into arrays and back."""

    def __init__(
        self,
        link: EmbeddedLink,
        devices: Sequence[Device],
        clock: SyncClock,
        rig: Rig,
        expected: Sequence[Frame],
        cycle_ns: int,
    ) -> None:
        """`expected`: like the frames of each cycle, SYNC the last. Raises NotPlainError where cycles are not plain."""
        self._link, self._devices, self._clock, self._cycle_ns = link, devices, clock, cycle_ns
        self._cycles = 0
        step_s, drives = rig.plain_step_s(), rig.drives
        if step_s is None or not all(drive.follows(_ENABLED) for drive in drives):
            raise NotPlainError
        if any(device.sync_cob_id != SYNC for device in devices):
            raise NotPlainError
        self._slots, self._frames = Slots(), Frames()
        for frame in expected:
            self._frames.add(frame.can_id, lay.SYNC if frame.can_id == SYNC else lay.BEFORE_SYNC, frame.data)
        if len(set(self._frames.cob_ids)) != len(expected):
            raise NotPlainError
        self._expects(expected)
        self._host = HostFrames(0, devices, drives, self._frames, self._slots, cycle_ns)
        self._host.receive()
        self._find_controlwords(drives)
        self._host.answer()
        rows = [drive_row(drive, self._slots) for drive in drives]
        self._arrays(rows)
        count = len(rows)
        self._motors = Motors(
            drives,
            self._drives,
            self._whole,
            self._real,
            self._asked,
            self._shown,
            rig.rig,
            step_s,
            self._slots.cells[0],
            alone=count == len(rig.ports),
            shows_ports=False,
        )
        self._until_ns = self._host.quiet_until_ns()

    def _expects(self, expected: Sequence[Frame]) -> None:
        """What is in the packet of a cycle, but for the bench's heartbeat, which comes before SYNC."""
        self._count = len(expected)
        self._cob_ids = tuple(frame.can_id for frame in expected)
        self._sizes = tuple(len(frame.data) for frame in expected)
        self._packets = Packets(self._link.dropped)

    def _find_controlwords(self, drives: Sequence[SimulatedDrive]) -> None:
        """Where they are in the data of a cycle's frames."""
        cells = [drive.firmware.controlword for drive in drives]
        slots = {self._slots.of_cells[id(cell)] for cell in cells if id(cell) in self._slots.of_cells}
        fields = [field for field in self._frames.received if field[1] in slots]
        self._controlwords = [(8 * row + offset, 8 * row + offset + width) for row, _, offset, width, _ in fields]

    def _arrays(self, drives: list[tuple[Any, ...]]) -> None:
        frames, slots = self._frames, self._slots
        self._rows, self._drives = table(frames.rows, lay.FRAME), table(drives, lay.DRIVE)
        self._whole = np.array([*slots.whole, 0], np.int64)
        self._real = np.array([*slots.real, 0.0], np.float64)
        self._data = np.zeros((len(frames.rows), 8), np.uint8)
        for row, content in frames.constants.items():
            self._data[row, : len(content)] = np.frombuffer(content, np.uint8)
        self._data_at = self._data.reshape(-1).data
        self._given = np.zeros(lay.I_SIZE, np.int64)
        self._given_at = self._given.data
        self._left = np.zeros(lay.O_SIZE + len(frames.rows), np.int64)
        self._sent = self._left[lay.O_SIZE + self._count :]  # bits of each answer; 0: not its turn
        self._asked, self._shown = np.zeros(len(drives)), np.zeros(lay.PORT_SIZE * len(drives))
        answers = len(frames.rows) - self._count
        self._records = np.zeros(answers, RECORD)
        self._records["can_id"], self._records["size"] = frames.cob_ids[self._count :], frames.sizes[self._count :]
        none, no_octets, no_real = np.zeros(0, np.int64), np.zeros(0, np.uint8), np.zeros(0)
        self._vectors = kernel.Vectors(
            table((), lay.TARGET),
            no_real,
            self._rows,
            table(frames.sent, lay.FIELD),
            table(sorted(frames.received), lay.FIELD),
            self._drives,
            table((), lay.SEEN),
            self._whole,
            self._real,
            self._given,
            self._left,
            self._data.reshape(-1),
            no_octets,
            no_octets,
            np.zeros(8, np.uint8),
            no_real,
            self._asked,
            self._shown,
            table((), lay.SAID),
            *(none, none, no_real, no_real, no_real),
        )
        self._table = self._vectors.table()

    def cycle(self, packet: bytes) -> bool:
        """What a packet asks for; False where that is not plain, and nothing was done."""
        begun_ns = time.monotonic_ns()
        if not self._still_plain(begun_ns) or not self._take(packet):
            return False
        self._given_at[lay.I_CLOCKS] = self._clock.next_ns
        if not kernel.exchange(self._table, _BITRATE):
            return False
        self._clock.tick_at(begun_ns)
        self._link.send_records(self._answers())
        self._motors.step()
        if not kernel.publish(self._table):
            self._motors.publish_by_objects()
        self._cycles += 1
        return True

    def _still_plain(self, now_ns: int) -> bool:
        if self._motors.over or not self._clock.runs_until(now_ns, self._until_ns):
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
            if not _is_heartbeat(heartbeat) or sizes[-2] != 1 or data[-16:-15] != _OPERATIONAL:
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
        self._until_ns = self._host.quiet_until_ns()

    def _answers(self) -> bytes:
        """Records of those whose turn it is."""
        self._records["data"] = self._data[self._count :]
        if self._left[lay.O_FRAMES] == len(self._rows):
            return bytes(self._records)
        return bytes(self._records[self._sent != 0])

    def end(self) -> None:
        """The objects get what the arrays have."""
        if not self._cycles:
            return
        self._motors.give()
        self._host.give(self._rows, self._data, self._cycles, self._clock.next_ns - 2 * self._cycle_ns)


def _is_heartbeat(can_id: int) -> bool:
    return HEARTBEAT < can_id <= HEARTBEAT + LAST_NODE
