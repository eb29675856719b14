"""Interface of a machine to the bench: its tasks, its quantities, its reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CyclicTask, SettableQuantity


@dataclass(frozen=True)
class MachineTasks:
    """Tasks and quantities of a kind of machine (`tasks` of `hilbench.machine_kinds.MachineDescription`)."""

    reference: Reference  #: brought to zero before the drives are disabled; has the rate at which it may be moved
    quantities: Sequence[SettableQuantity]  #: settable by path, in addition to effects in the simulated hardware
    control: Sequence[CyclicTask]  #: in each exchange: set points of every drive, in the order in which they are made
    watches: Sequence[CyclicTask]  #: in each cycle of the experiment: limits and notices
    twin_age_limit_cycles: int  #: age of the twin's data up to which the controllers ride it out
    warm_up: Callable[[], None]  #: compiles what a cycle runs, before one has to wait for it
    #: What an axis holds that no other holds in its place, by its drive: it is lost when the axis coasts.
    holds: Mapping[str, str] = field(default_factory=dict)
