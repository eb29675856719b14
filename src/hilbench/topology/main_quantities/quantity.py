"""Description of a quantity that a person changes during a run."""

from __future__ import annotations

from dataclasses import dataclass
from math import isinf
from typing import Final

#: What a twin's value is, for a legend or a heading.
ESTIMATED: Final = "estimated"
OF_THE_MODEL: Final = "of the model"


def text_of_deviation(deviation: float) -> str:
    """Text for a twin's value with this standard deviation: the model's where that is inf, else estimated."""
    return OF_THE_MODEL if isinf(deviation) else ESTIMATED


@dataclass(frozen=True)
class MainQuantity:
    """One quantity by its path (`hilbench.topology.quantities`), and how it is spoken of."""

    path: str
    title: str  #: for a prompt for a value
    short: str  #: beside a number, in a table or at the edge of a picture
    unit: str  #: SI
    signal: str  #: the signal of a recording that shows what was set
    key: str  #: what asks for it in the monitor
    twin_signal: str = ""  #: the same as the twin simulates or estimates it
    twin_deviation: str = ""  #: standard deviation of that, as the twin states it; inf: it is its model's value
    of: str = ""  #: what it is a set-point of; "" for what is meant itself
    shown_unit: str = ""  #: in which a person gives it; the SI unit if not given
    si_per_shown: float = 1.0
    #: A property of the emulated machine: it may drift by itself, and a step of it is a share of its value.
    emulated: bool = False

    @property
    def in_unit(self) -> str:
        """The unit in which a person gives it."""
        return self.shown_unit or self.unit
