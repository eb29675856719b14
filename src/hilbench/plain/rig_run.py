"""Plain cycles of simulated hardware: the devices' answers to a SYNC, then a step of the rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hilbench.chain import GOES_ON
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.plain import kernel
from hilbench.plain.motors import Motors
from hilbench.plain.packet_kernel import ANSWERED, NOTHING, SYNCED
from hilbench.plain.sync_answers import ClockedAnswers, SyncAnswers
from hilbench.plain.tables import NotPlainError
from hilbench.plant.interface import Steps


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


class RigTime(Protocol):
    """How far a rig has to go, in sample times: `hilbench.hardware.plant_time`."""

    def before_sync(self, behind: int) -> int:
        """To the time of a SYNC."""

    def after_sync(self) -> int:
        """To that of the next one."""


def _motors(answers: ClockedAnswers | SyncAnswers, rig: Rig, step_s: float) -> Motors:
    return Motors(
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


class _AnswersAndMotors:
    """Answers to SYNC, and what they show of motors that go a step after each."""

    def __init__(self, answers: SyncAnswers | ClockedAnswers, rig: Rig, step_s: float) -> None:
        """Raises NotPlainError where cycles are not plain."""
        answers.fill()
        self._of_sync, self._motors = answers, _motors(answers, rig, step_s)

    @property
    def came(self) -> Sequence[bytes]:
        """See `host.PacketRun`."""
        return self._of_sync.came

    @property
    def cycles(self) -> int:
        """See `host.PacketRun`."""
        return self._of_sync.cycles

    def _publish(self) -> None:
        if kernel.publish(0, self._of_sync.table) != GOES_ON:
            self._motors.publish_by_objects()

    def end(self) -> None:
        """See `host.PacketRun`."""
        if self._of_sync.cycles:
            self._motors.give()
            self._of_sync.give()


class RigRun(_AnswersAndMotors):
    """See `host.PacketRun`."""

    def __init__(self, answers: SyncAnswers, rig: Rig) -> None:
        """Raises NotPlainError where cycles are not plain."""
        step_s = rig.plain_step_s()
        if step_s is None:
            raise NotPlainError
        super().__init__(answers, rig, step_s)
        self._answers = answers

    def serve(self, timeout_s: float) -> bool:
        """See `host.PacketRun`."""
        if self._motors.over:
            return False
        outcome = self._answers.serve(timeout_s)
        if outcome != ANSWERED:
            return outcome == NOTHING and not self._answers.stands
        self._motors.step()
        self._publish()
        return True


class ClockedRigRun(_AnswersAndMotors):
    """The same where the rig goes by `time`, in sample times of the drives' loops (`sample_s`), and so many of them in
    a step at most."""

    def __init__(self, answers: ClockedAnswers, rig: Rig, time: RigTime, sample_s: float, longest_step: int) -> None:
        super().__init__(answers, rig, longest_step * sample_s)
        self._answers, self._time = answers, time
        self._sample_s, self._longest_step = sample_s, longest_step
        self._steps: dict[int, Callable[[], object]] = {longest_step: self._motors.step}  # by their sample times

    def serve(self, timeout_s: float) -> bool:
        """See `host.PacketRun`."""
        if self._motors.over:
            self._answers.leave()
            return False
        outcome = self._answers.await_sync(timeout_s)
        if outcome != SYNCED:
            return outcome == NOTHING
        self._go(self._time.before_sync(0))
        if self._motors.over:  # SYNC, too, is for the objects
            self._answers.leave()
            return False
        self._answers.answer()
        samples = self._time.after_sync()
        if samples:
            self._go(samples)
        else:  # ahead of time already: the new set points are taken all the same
            self._publish()
        return True

    def _go(self, samples: int) -> None:
        while samples > 0 and not self._motors.over:
            step = min(samples, self._longest_step)
            if step not in self._steps:
                self._steps[step] = self._motors.step_of(step * self._sample_s)
            self._steps[step]()
            self._publish()
            samples -= step
