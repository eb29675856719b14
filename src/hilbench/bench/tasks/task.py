"""What runs in every cycle, behind one small interface: so a machine is to the bench no more than a list of tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Literal, Protocol, TypeVar

from hilbench.cycle_program import CompiledStage
from hilbench.exchange.exchange import Inputs
from hilbench.topology.sample import CycleSample

#: What goes to the nodes with the next SYNC, SI: set points by the names of the drives (velocity on the side of the
#: machine, or torque at the shaft), and what the twin gets to know, by the names of the signals.
Outputs = dict[str, float]


#: More cycles than anybody asks for.
MANY = 1 << 30


def _many() -> int:
    return MANY


def _nothing(cycles: int) -> None:
    """Nobody counts them."""


@dataclass(frozen=True)
class CompiledStages:
    """What a task does in cycles that go without Python; none of it: it has nothing to do in such.

    `cycles`: how many from the next one on may go so (0: the next one is Python's); asked right before they do. `went`:
    so many have. `shown`: the signals that show what it puts into the outputs, by the names of these.
    """

    before: Sequence[CompiledStage] = ()
    after: Sequence[CompiledStage] = ()
    cycles: Callable[[], int] = _many
    went: Callable[[int], None] = _nothing
    shown: Mapping[str, str] = field(default_factory=dict)


Made = TypeVar("Made")


class PerSample(Generic[Made]):
    """What is made on the vectors of a sample, for who gets samples one by one: mostly the same object."""

    def __init__(self, make: Callable[[CycleSample], Made]) -> None:
        self._make = make
        self._sample: CycleSample | None = None
        self._made: Made

    def __call__(self, sample: CycleSample) -> Made:
        """On this one."""
        if sample is not self._sample:
            self._made, self._sample = self._make(sample), sample
        return self._made


class CyclicTask:
    """One thing that is done in every cycle; a task overrides the moments in which it has something to do.

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
        """`before` and `after` as pieces of a cycle, on this sample; None: it is Python's in every cycle."""
        return None


def overrides(task: CyclicTask, moment: Literal["before", "after", "rest"]) -> bool:
    """Whether a task has something to do in this moment: the others need no call in every cycle."""
    return getattr(type(task), moment) is not getattr(CyclicTask, moment)


class SettableQuantity(Protocol):
    """Something of a task that an experiment may change under way, by the paths of `hilbench.topology.quantities`."""

    def owns(self, path: str) -> bool:
        """Whether it is this one's."""

    def value(self, path: str) -> float:
        """Present value, SI."""

    def set(self, path: str, value: float) -> None:
        """Another value from the next cycle on."""
