"""Plain cycles of the twin's process: its nodes answer SYNC, then the machine goes on by what the axes answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilbench.plain import kernel
from hilbench.plain import layout as lay
from hilbench.plain.packets import Packets
from hilbench.plain.sync_answers import BITRATE, SyncAnswers
from hilbench.plain.tables import Frames, NotPlainError, new_slots, table
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.in_arrays import TwinInArrays, give_counters, heard_row
from hilbench.twin.process import TwinApplication


@dataclass(frozen=True)
class _Order:
    """The axes' TPDOs in the order in which they come; `data`: (8 N,)."""

    vectors: kernel.Vectors
    table: kernel.Table
    data: memoryview[int]


class HeardAxes:
    """What the twin hears of the axes: takes their TPDOs out of packets, until each has answered."""

    def __init__(self, listeners: Sequence[AxisListener], answers: SyncAnswers, dropped: int) -> None:
        """Raises NotPlainError."""
        self._listeners, self._answers = listeners, answers
        self._by_cob_id = {listener.cob_id: listener for listener in listeners}
        self._slots = {listener.cob_id: new_slots(answers.slots, listener.pdo) for listener in listeners}
        self._seen = table([self._row(listener) for listener in listeners], lay.SEEN)
        if len(self._by_cob_id) != len(listeners):
            raise NotPlainError
        self.measured = np.zeros(4 * len(listeners))
        self._orders: dict[tuple[int, ...], _Order] = {}
        self.packets = Packets(dropped)

    def _row(self, listener: AxisListener) -> tuple[object, ...]:
        taken = self._slots[listener.cob_id]
        return heard_row(listener, taken[listener.position], taken[listener.torque])

    def take(self, packet: bytes) -> bool | None:
        """Whether all have answered; None where something else has come."""
        packets = self.packets
        if not packets.take(packet):
            return None
        cob_ids = packets.cob_ids
        order = self._orders.get(cob_ids)
        if order is None:
            if len(set(cob_ids)) != len(cob_ids) or not set(cob_ids) <= set(self._by_cob_id):
                return None
            if len(cob_ids) < len(self._listeners):
                return False
            order = self._orders[cob_ids] = self._new(cob_ids)
        if packets.sizes != tuple(self._by_cob_id[cob_id].size for cob_id in cob_ids):
            return None
        order.data[: len(packets.data)] = packets.data
        kernel.exchange(order.table, BITRATE)
        return True

    def _new(self, cob_ids: Sequence[int]) -> _Order:
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
        return _Order(vectors, vectors.table(), data.data)

    def give(self) -> None:
        """The listeners know what has come."""
        give_counters(self._listeners, self._seen)


class TwinRun:
    """See `plain.host.PacketRun`."""

    def __init__(self, answers: SyncAnswers, application: TwinApplication, dropped: int) -> None:
        """Raises NotPlainError where cycles are not plain."""
        self.came: Sequence[bytes] = ()
        self._awaits = False  # SYNC is answered, the axes have to
        self._answers, self._application = answers, application
        self._machine = TwinInArrays(application, answers.host, answers.slots)
        self._axes = HeardAxes(application.listeners, answers, dropped)
        answers.fill()
        self._machine.join(
            answers.drives, answers.whole, answers.real, answers.asked, answers.shown, self._axes.measured
        )

    def take(self, packet: bytes) -> bool:
        """See `plain.host.PacketRun`."""
        if self._awaits:
            return self._go_on(packet)
        self.came = (packet,)
        if not self._machine.stays():
            return False
        self._machine.before_sync()
        if not self._answers.answer(packet):
            return False
        self._axes.packets.begin()
        self.came, self._awaits = self._axes.packets.all, True
        return True

    def _go_on(self, packet: bytes) -> bool:
        """With what the axes say; False where something else has come."""
        is_all = self._axes.take(packet)
        if is_all is None:
            return False
        if is_all:
            self._machine.go_on()
            if not kernel.publish(self._answers.table):
                self._machine.publish_by_objects()
            self._awaits = False
        return True

    def end(self) -> None:
        """See `plain.host.PacketRun`."""
        if self._answers.has_answered:
            self._machine.give(awaits=self._awaits)
            self._answers.give()
            self._axes.give()
