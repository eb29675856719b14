"""Base of all machines' futures: a prediction from the present estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from hilbench.prediction.outlook import Outlook, WatchedQuantity
from hilbench.prediction.tally import Offsets

Present = TypeVar("Present")
Courses = TypeVar("Courses")


class Futures(ABC, Generic[Present, Courses]):
    """Futures of one machine, drawn and simulated; `watched`: its quantities, Q, in the order of its kernel.

    `Present`: its present estimate; `Courses`: its future set points.
    """

    def __init__(self, watched: Sequence[WatchedQuantity]) -> None:
        self.watched = tuple(watched)

    @property
    def quantities(self) -> int:
        """Number of quantities, Q."""
        return len(self.watched)

    @abstractmethod
    def prepare(
        self, present: Present, courses: Courses, offsets: Offsets, *key: int
    ) -> tuple[Callable[[], None], Callable[[], Outlook]]:
        """Prepare a prediction: the simulation, which takes its time and releases the GIL, and the function of its
        result.

        `key`: seed of all draws; equal arguments give an equal outlook.
        """

    @abstractmethod
    def at_rest(self) -> tuple[Present, Courses]:
        """Present and courses of a machine at rest that stays at rest."""

    def look(self, present: Present, courses: Courses, offsets: Offsets, *key: int) -> Outlook:
        """Run a prediction in one call."""
        run, outlook = self.prepare(present, courses, offsets, *key)
        run()
        return outlook()

    def no_offsets(self) -> Offsets:
        """Offsets of measurements without noise and without deviation from the futures."""
        return Offsets.none(self.quantities)

    def warm_up(self) -> None:
        """Compile, or load, the functions of a prediction."""
        self.look(*self.at_rest(), self.no_offsets())
