"""Fast path of the twin's process: its nodes answer SYNC, then the machine steps by the axes' answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilbench.can.embedded import EmbeddedLink
from hilbench.cycle_program import CONTINUE
from hilbench.fast_path import kernel, packet_kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.packet_kernel import ANSWERED, BITRATE, NOTHING, OTHER, RECEIVE, TAKEN, Gathered
from hilbench.fast_path.sync_answers import SyncAnswers
from hilbench.fast_path.tables import FastPathRefusedError, Frames, new_slots, table
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.in_arrays import TwinInArrays, give_counters, received_row
from hilbench.twin.process import TwinApplication


@dataclass(frozen=True)
class _Order:
    """TPDOs of the axes in a fixed arrival order; `data`: (8 N,)."""

    vectors: kernel.Vectors
    port: packet_kernel.Port
    table: kernel.Table
    port_table: kernel.Table


class ReceivedAxes:
    """Receiver of the axes' TPDOs: takes them from packets until each axis has answered."""

    def __init__(self, link: EmbeddedLink, listeners: Sequence[AxisListener], answers: SyncAnswers) -> None:
        """Raises FastPathRefusedError, as for axes with the same COB-ID."""
        self._link, self._listeners, self._answers = link, listeners, answers
        self._by_cob_id = {listener.cob_id: listener for listener in listeners}
        self._slots = {listener.cob_id: new_slots(answers.slots, listener.pdo) for listener in listeners}
        self._seen = table([self._row(listener) for listener in listeners], lay.FEEDBACK)
        if len(self._by_cob_id) != len(listeners):
            raise FastPathRefusedError
        self.measured = np.zeros(4 * len(listeners))
        self._orders: dict[tuple[int, ...], _Order] = {}
        self._gathered = Gathered(link.fileno(), link.dropped)

    def _row(self, listener: AxisListener) -> tuple[object, ...]:
        taken = self._slots[listener.cob_id]
        return received_row(listener, taken[listener.position], taken[listener.torque])

    def _in_order(self, cob_ids: Sequence[int]) -> _Order:
        frames, answers = Frames(), self._answers
        for cob_id in cob_ids:
            pdo = self._by_cob_id[cob_id].pdo
            frames.take(frames.add(cob_id, lay.ANSWER, bytes(pdo.size)), pdo, self._slots[cob_id])
        data = np.zeros(8 * len(cob_ids), np.uint8)
        vectors = kernel.Vectors(
            frames=table(frames.rows, lay.FRAME),
            received=table(frames.received, lay.FIELD),
            seen=self._seen,
            feedback=self.measured,
            whole=answers.whole,
            real=answers.real,
            given=np.zeros(lay.I_SIZE, np.int64),
            left=np.zeros(lay.O_SIZE + len(cob_ids), np.int64),
            data=data,
        )
        wire = np.column_stack((frames.cob_ids, frames.sizes)).astype(np.int64)
        none, nothing = np.zeros((0, 5), np.int64), np.zeros(0, np.uint8)
        port = packet_kernel.new_port(-1, 0, wire, none, wire[:0], vectors.left, data, nothing)
        return _Order(vectors, port, vectors.table(), port.table())

    def give(self) -> None:
        """Write the counters back to the listeners."""
        give_counters(self._listeners, self._seen)

    @property
    def came(self) -> Sequence[bytes]:
        """Packets of this cycle."""
        return self._gathered.packets

    def begin(self) -> None:
        """Start receiving after the answer to SYNC."""
        self._gathered.begin()

    def serve(self, timeout_s: float) -> int:
        """Receive frames: ANSWERED by all axes; NOTHING within the time; OTHER: not for the fast path."""
        gathered, stage = self._gathered, RECEIVE
        while (outcome := packet_kernel.gather(gathered.table, len(self._listeners), stage)) == NOTHING:
            packet = self._link.receive_packet(timeout_s)
            if packet is None:
                return NOTHING
            gathered.put(packet)
            stage = TAKEN
        order = self._order(gathered.cob_ids) if outcome == ANSWERED else None
        if order is None or not packet_kernel.take_apart(order.table, order.port_table, gathered.table, BITRATE):
            return OTHER
        return ANSWERED

    def _order(self, cob_ids: tuple[int, ...]) -> _Order | None:
        order = self._orders.get(cob_ids)
        if order is None and len(cob_ids) == len(self._listeners) and set(cob_ids) == set(self._by_cob_id):
            order = self._orders[cob_ids] = self._in_order(cob_ids)
        return order


class TwinFastCycle:
    """Packet runner of the twin, see `fast_path.host.PacketRun`: its nodes' answers, then the axes'."""

    def __init__(self, link: EmbeddedLink, answers: SyncAnswers, application: TwinApplication) -> None:
        """Raises FastPathRefusedError where the fast path is not possible."""
        self._answers, self._axes = answers, ReceivedAxes(link, application.listeners, answers)
        self._awaits = False  # SYNC is answered, the axes have to
        self._machine = TwinInArrays(application, answers.host, answers.slots)
        answers.fill()
        self._machine.join(
            *(answers.drives, answers.whole, answers.real, answers.asked, answers.shown), self._axes.measured
        )
        self._machine.before_sync()

    @property
    def came(self) -> Sequence[bytes]:
        """Packets of this cycle, see `fast_path.host.PacketRun`."""
        return self._axes.came if self._awaits else self._answers.came

    def serve(self, timeout_s: float) -> bool:
        """Receive and process packets, see `fast_path.host.PacketRun`."""
        if self._awaits:
            outcome = self._axes.serve(timeout_s)
            if outcome == ANSWERED:
                self._go_on()
        elif not self._machine.stays():
            return False
        else:
            outcome = self._answers.serve(timeout_s)
            if outcome == ANSWERED:
                self._axes.begin()
                self._awaits = True
        return outcome == ANSWERED or (outcome == NOTHING and not self._answers.is_active)

    def _go_on(self) -> None:
        """Run the machine by the axes' answers."""
        self._machine.go_on()
        if kernel.publish(0, self._answers.table) != CONTINUE:
            self._machine.publish_by_objects()
        self._machine.before_sync()
        self._awaits = False

    def end(self) -> None:
        """Leave the fast path, see `fast_path.host.PacketRun`."""
        if not self._answers.cycles:
            self._machine.leave()
            return
        self._machine.give(awaits=self._awaits)
        self._answers.give()
        self._axes.give()
