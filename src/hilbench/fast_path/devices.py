"""The devices of a host in the tables of the fast path: RPDOs, answers, heartbeats."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.canopen.device import Device
from hilbench.canopen.device_pdo import Rpdo, Tpdo
from hilbench.canopen.identifiers import HEARTBEAT, NmtState
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.fast_path import layout as lay
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots, cell_slots


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
            if not rpdo.idle:
                raise FastPathRefusedError
            return
        if not rpdo.fits_fast_path(self._cycle_ns) or rpdo.map is None:
            raise FastPathRefusedError
        if any(cell.on_write is not None and cell not in self._controlwords for cell in rpdo.cells):
            raise FastPathRefusedError
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

    def give(self, rows: lay.Rows, data: lay.Bytes, cycles: int, received_ns: int) -> None:
        """Update the devices after so many cycles: the last RPDOs came at `received_ns`, and `data` (F, 8) holds the
        last data of the frames."""
        for _, rpdo, _ in self.taken:
            rpdo.received_until(received_ns)
        for device, row in self.heartbeats:
            device.producer.sent_until(int(rows[row]["next_ns"]))
        for _, tpdo, row in self.answering:
            count = int(rows[row]["count"])
            tpdo.sent_until(count, data[row].tobytes()[: self._frames.sizes[row]] if count < cycles else None)
