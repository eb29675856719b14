"""Fast-path cycles of simulated hardware: the devices' answers to a SYNC, then a step of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cycle_program import CONTINUE
from hilbench.fast_path import kernel
from hilbench.fast_path.motors import Motors
from hilbench.fast_path.packet_kernel import ANSWERED, NOTHING
from hilbench.fast_path.sync_answers import SyncAnswers
from hilbench.fast_path.tables import FastPathRefusedError
from hilbench.plant.interface import Steps


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
        self._answers = answers
        self._motors = Motors(
            rig.drives,
            answers.drives,
            answers.whole,
            answers.real,
            answers.asked,
            answers.shown,
            rig.rig,
            step_s,
            answers.slots.cells[0],
            alone=len(rig.drives) == len(rig.ports),
            shows_ports=False,
        )

    @property
    def came(self) -> Sequence[bytes]:
        """Packets left for the host."""
        return self._answers.came

    def serve(self, timeout_s: float) -> bool:
        """Serve the next packet (`host.PacketRun.serve`), then step the rig."""
        if self._motors.over:
            return False
        outcome = self._answers.serve(timeout_s)
        if outcome != ANSWERED:
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
