"""What the futures of all machines have in common: a look ahead, from what is known of the present."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from hilbench.prediction.outlook import DiagnosisAnswer, Outlook
from hilbench.prediction.tally import Offsets

Present = TypeVar("Present")
Courses = TypeVar("Courses")


class Futures(ABC, Generic[Present, Courses]):
    """Draws and runs the futures of one machine; `watched`: its quantities, Q, in the order of its kernel.

    `Present`: what is known of it now; `Courses`: what it will be asked for.
    """

    def __init__(self, watched: Sequence[DiagnosisAnswer]) -> None:
        self.watched = tuple(watched)

    @property
    def quantities(self) -> int:
        """Q."""
        return len(self.watched)

    @abstractmethod
    def prepare(
        self, present: Present, courses: Courses, offsets: Offsets, *key: int
    ) -> tuple[Callable[[], None], Callable[[], Outlook]]:
        """Two parts of a look ahead: what takes its time and lets other threads run, and what says what came out.

        `key`: numbers from which all is drawn; the same look has the same outlook.
        """

    @abstractmethod
    def at_rest(self) -> tuple[Present, Courses]:
        """A machine that stands and is to stand."""

    def look(self, present: Present, courses: Courses, offsets: Offsets, *key: int) -> Outlook:
        """Both parts at once."""
        run, outlook = self.prepare(present, courses, offsets, *key)
        run()
        return outlook()

    def no_offsets(self) -> Offsets:
        """Measured without noise, and as the futures say."""
        return Offsets.none(self.quantities)

    def warm_up(self) -> None:
        """Compile, or load, what a look runs."""
        self.look(*self.at_rest(), self.no_offsets())
