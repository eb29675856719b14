"""Interface of observers that see a run as it happens."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from hilbench.bench.tasks.task import CompiledStages
from hilbench.topology.sample import CycleSample


class CycleObserver(Protocol):
    """Sees a run as it happens: recorder, progress display, an experiment's own code."""

    def sample(self, sample: CycleSample) -> None:
        """One cycle of the enabled bench; the object is reused, so copy what is kept."""


@runtime_checkable
class CompiledObserver(Protocol):
    """An observer that need not see a cycle by itself."""

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages of the observer."""
