"""Signals that the twin sends with every SYNC, as the monitor shows them over time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import isinf, nan

from hilbench.machine_kinds import machine_part
from hilbench.topology.main_quantities.of_kind import main_quantities
from hilbench.topology.main_quantities.quantity import OF_THE_MODEL
from hilbench.topology.signals import Shape, unit_of

_POINTS = 240


@dataclass
class Trend:
    """One signal of the twin: its name in a recording, and its title for display."""

    signal: str
    title: str
    unit: str
    si_per_unit: float = 1.0
    deviation: str = ""  #: the signal of its standard deviation, of an estimate
    stated: float = nan  #: that, as the twin last stated it, SI
    values: deque[float] = field(default_factory=lambda: deque(maxlen=_POINTS))  #: SI

    @property
    def is_of_the_model(self) -> bool:
        """True if the value is the model's, as it is not identifiable (infinite deviation)."""
        return isinf(self.stated)

    @property
    def heading(self) -> str:
        """The title with what it is, where it is no estimate."""
        return f"{self.title} {OF_THE_MODEL}" if self.is_of_the_model else self.title

    @property
    def shown(self) -> list[float]:
        """The values in the unit."""
        return [value / self.si_per_unit for value in self.values]


def trends_of(kind: str, shape: Shape) -> list[Trend]:
    """Trends of the signals that a machine's twin sends with every SYNC, in the order of its PDOs."""
    known = {each.twin_signal: each for each in main_quantities(kind, shape) if each.twin_signal}
    trends = []
    for carried in machine_part(kind, "topology").process_data(shape).state:
        name, quantity = carried.name, known.get(carried.name)
        if quantity is None:
            trends.append(Trend(name, name, unit_of(name)))
        else:
            title, unit = quantity.of or quantity.short, quantity.in_unit
            trends.append(Trend(name, title, unit, quantity.si_per_shown, quantity.twin_deviation))
    return trends
