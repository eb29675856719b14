"""Fast path of the twin's process: its nodes answer SYNC, then the machine steps by the axes' answers."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.cycle_program import CONTINUE
from hilbench.fast_path import kernel, packet_kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.host_cycle import SyncAnswers
from hilbench.fast_path.packet_kernel import NOTHING
from hilbench.fast_path.tables import FastPathRefusedError, new_slots
from hilbench.twin.in_arrays import TwinInArrays, give_counters, received_row
from hilbench.twin.process import TwinApplication


class TwinFastCycle:
    """Packet runner of the twin, see `fast_path.host.PacketRun`: its nodes' answers, then the axes'."""

    def __init__(self, answers: SyncAnswers, application: TwinApplication) -> None:
        """Raises FastPathRefusedError where the fast path is not possible, as for axes with the same COB-ID."""
        self._answers, self._application, self._listeners = answers, application, application.listeners
        self._awaits = False  # SYNC is answered, the axes have to
        self._machine = TwinInArrays(application, answers.slots)
        received = []
        for listener in self._listeners:
            taken = new_slots(answers.slots, listener.pdo)
            row = answers.frames.add(listener.cob_id, lay.ANSWER, bytes(listener.pdo.size))
            answers.frames.take(row, listener.pdo, taken)
            received.append(received_row(listener, taken[listener.position], taken[listener.torque]))
        if len({listener.cob_id for listener in self._listeners}) != len(received):
            raise FastPathRefusedError
        answers.fill(received)
        image = answers.image
        self._machine.join(image.drives, image.whole, image.real, image.asked, image.shown, image.feedback)

    @property
    def came(self) -> Sequence[bytes]:
        """Packets of this cycle, see `fast_path.host.PacketRun`."""
        return self._answers.came

    def serve(self, timeout_s: float) -> bool:
        """Receive and process packets, see `fast_path.host.PacketRun`."""
        answers = self._answers
        if self._awaits:
            outcome = answers.receive(packet_kernel.hear, timeout_s)
            if outcome == CONTINUE:
                self._go_on()
        elif not self._machine.stays():
            return False
        else:
            outcome = answers.serve(timeout_s)
            self._awaits = outcome == CONTINUE
        return outcome == CONTINUE or (outcome == NOTHING and not answers.is_active)

    def _go_on(self) -> None:
        """Run the machine by the axes' answers."""
        self._application.go_on_in_vectors()
        if kernel.publish(0, self._answers.table) != CONTINUE:
            self._machine.publish_by_objects()
        self._awaits = False

    def end(self) -> None:
        """Leave the fast path, see `fast_path.host.PacketRun`."""
        if not self._answers.cycles:
            self._application.forget_vectors()
            return
        self._machine.give(awaits=self._awaits)
        self._answers.give()
        give_counters(self._listeners, self._answers.image.seen)
