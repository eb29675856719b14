"""What runs in every cycle, behind one small interface: so a machine is to the bench no more than a list of tasks."""

from __future__ import annotations

from typing import Literal, Protocol

from hilbench.exchange.exchange import Inputs
from hilbench.topology.sample import CycleSample

#: What goes to the nodes with the next SYNC, SI: set points by the names of the drives (velocity on the side of the
#: machine, or torque at the shaft), and what the twin gets to know, by the names of the signals.
Outputs = dict[str, float]


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
