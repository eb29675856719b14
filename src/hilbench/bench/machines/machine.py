"""What a machine is to the bench: its tasks, its quantities, its reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CyclicTask, SettableQuantity


@dataclass(frozen=True)
class MachineTasks:
    """What a kind of machine brings to a bench (`hilbench.bench.machines.kinds` chooses the kind)."""

    reference: Reference  #: what is brought to zero before the drives are let go, and at which rate it may be moved
    quantities: Sequence[SettableQuantity]  #: that can be set by path, beside effects in the simulated hardware
    control: Sequence[CyclicTask]  #: in each exchange: set points of every drive, in the order in which they are made
    watches: Sequence[CyclicTask]  #: in each cycle of the experiment: what must not be, and what is to be reported
    twin_age_limit_cycles: int  #: up to which the controllers ride out that the twin's data are old
    warm_up: Callable[[], None]  #: compiles what a cycle runs, before one has to wait for it
    #: What an axis holds that no other holds in its place, by its drive: it is lost when the axis coasts.
    holds: Mapping[str, str] = field(default_factory=dict)
