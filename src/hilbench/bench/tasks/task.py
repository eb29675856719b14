"""Interface of a task: a machine is to the bench a list of tasks that run in every cycle."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Literal, Protocol, runtime_checkable

from hilbench.cycle_program import CompiledStage, python_stage
from hilbench.exchange.exchange import Inputs
from hilbench.topology.sample import CycleSample, PerSample

#: What goes to the nodes with the next SYNC, SI: set points by the names of the drives (velocity on the side of the
#: machine, or torque at the shaft), and what the twin gets to know, by the names of the signals.
Outputs = dict[str, float]


#: More cycles than are ever requested.
MANY = 1 << 30


def _nothing(cycles: int) -> None:
    """Ignore the count of cycles run."""


@dataclass(frozen=True)
class CompiledStages:
    """Compiled stages of a task; all empty if it has nothing to do in compiled cycles.

    `cycles`: number of cycles from the next on that may run compiled (0: the next needs Python); called right before
    they run. `went`: called with the number run. `shown`: signals that hold the task's outputs, by output name.
    """

    before: Sequence[CompiledStage] = ()
    after: Sequence[CompiledStage] = ()
    cycles: Callable[[], int] = lambda: MANY
    went: Callable[[int], None] = _nothing
    shown: Mapping[str, str] = field(default_factory=dict)


class CyclicTask:
    """Task of every cycle; it overrides the hooks in which it has something to do.

    A task of the machine runs in each exchange with the nodes: `before` and `after` while the drives are enabled, else
    `rest`. One that watches the run does so in each cycle of the experiment, and never rests. Whatever a task raises
    ends the run in the safe state.
    """

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Put set points into `outputs` from the last sample (and into the sample what is recorded of them)."""

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """The answers to SYNC are in the sample."""

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The drives are off; one that has no set point gets zero."""

    def compiled_stages(self, sample: CycleSample) -> CompiledStages | None:
        """Compiled stages for `before` and `after` on this sample; None: every cycle needs Python."""
        return None


class StagedTask(CyclicTask):
    """Task that is made of stages: the interpreter runs the same ones, one by one."""

    @cached_property
    def _staged(self) -> PerSample[CompiledStages]:
        return PerSample(self.stages)

    @abstractmethod
    def stages(self, sample: CycleSample) -> CompiledStages:
        """Stages on this sample, made once."""

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """The stages."""
        return self._staged(sample)

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Run the stages before the exchange; outputs are what the sample shows of them."""
        staged = self._staged(sample)
        for stage in staged.before:
            stage()
        for output, signal in staged.shown.items():
            outputs[output] = getattr(sample, signal)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Run the stages after the exchange."""
        for stage in self._staged(sample).after:
            stage()


def overrides(task: CyclicTask, moment: Literal["before", "after", "rest"]) -> bool:
    """True if a task overrides this hook: the others need no call in every cycle."""
    return getattr(type(task), moment) is not getattr(CyclicTask, moment)


class SettableQuantity(Protocol):
    """Quantities of a task that an experiment may change in a run, by the paths of `hilbench.topology.quantities`."""

    def owns(self, path: str) -> bool:
        """True if this object owns the path."""

    def value(self, path: str) -> float:
        """Present value, SI."""

    def set(self, path: str, value: float) -> None:
        """Another value from the next cycle on."""


class SensedLoop(StagedTask):
    """Loop of a set-point, in Python, from what sensors report; it owns settable quantities, see `SettableQuantity`.

    `values`: by path, the set-point first; `recorded`: signal that shows the set-point, "" for none; `shown`: signals
    that hold the task's outputs, by output name.
    """

    def __init__(self, values: dict[str, float], recorded: str, shown: Mapping[str, str]) -> None:
        super().__init__()
        self._values, self._recorded, self._shown = values, recorded, shown
        self._reported = False  # the sensors have, since the drives were enabled

    @property
    def _set_point(self) -> float:
        return next(iter(self._values.values()))

    def owns(self, path: str) -> bool:
        """True if the task has this quantity."""
        return path in self._values

    def value(self, path: str) -> float:
        """Present value."""
        return self._values[path]

    def set(self, path: str, value: float) -> None:
        """Another one."""
        self._values[path] = value

    @abstractmethod
    def _control(self, sample: CycleSample) -> None:
        """Command from the last sample."""

    def _record(self, sample: CycleSample) -> None:
        if self._recorded:
            setattr(sample, self._recorded, self._set_point)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Record the set-point; the sensors report now."""
        self._reported = True
        self._record(sample)

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Python's stage that commands; the sample shows the set-point, and keeps it."""

        def cycles() -> int:
            recorded = not self._recorded or getattr(sample, self._recorded) == self._set_point
            return MANY if self._reported and recorded else 0

        return CompiledStages(
            before=[python_stage(partial(self._control, sample))], cycles=cycles, shown=dict(self._shown)
        )

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """All is as at the start when the drives are enabled again."""
        self._reported = False
        self._record(sample)


class CycleObserver(Protocol):
    """Sees a run as it happens: recorder, progress display, an experiment's own code."""

    def sample(self, sample: CycleSample) -> None:
        """One cycle of the enabled bench; the object is reused, so copy what is kept."""


@runtime_checkable
class CompiledObserver(Protocol):
    """An observer that need not see a cycle by itself."""

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages of the observer."""
