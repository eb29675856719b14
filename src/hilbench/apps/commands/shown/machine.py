"""What the terminal shows of the runs of a kind of machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hilbench.topology.main_quantities.quantity import text_of_deviation
from hilbench.topology.sample import CycleSample


@dataclass(frozen=True)
class LiveRow:
    """A line of the live table: signals beside each other, in one unit that is so many SI units. `deviation`: signal of
    the standard deviation of the last of them, where the title has to say what that is."""

    title: str
    signals: Sequence[str]
    unit: str
    form: str  #: format of each number
    si_per_unit: float = 1.0
    deviation: str = ""

    def heading(self, sample: CycleSample) -> str:
        """The title beside the values of a sample."""
        return f"{self.title} / {text_of_deviation(getattr(sample, self.deviation))}" if self.deviation else self.title

    def text(self, sample: CycleSample) -> str:
        """The values of a sample."""
        values = (format(getattr(sample, name) / self.si_per_unit, self.form) for name in self.signals)
        return f"{' / '.join(values)} {self.unit}"


@dataclass(frozen=True)
class Shown:
    """`of_steps`: figures of each step that the terminal has room for, by heading and metric."""

    live: Sequence[LiveRow]
    of_steps: Sequence[tuple[str, str]]
