"""The main quantities of a machine, by path, and by the signals of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from hilbench.topology.main_quantities import servo_axis, web_line
from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.signals import SMALLEST, Shape, shape_of


def main_quantities(kind: str, shape: Shape) -> tuple[MainQuantity, ...]:
    """Main quantities of a kind of machine with these parts."""
    return servo_axis.QUANTITIES if kind == "servo_axis" else web_line.quantities(shape)


@cache
def find_quantity(path: str) -> MainQuantity | None:
    """The main quantity with a path; None for one that is none, as a parameter of an effect."""
    numbered = web_line.numbered(path)
    if numbered is not None:
        return numbered
    known = (each for kind, shape in SMALLEST.items() for each in main_quantities(kind, shape))
    return next((each for each in known if each.path == path), None)


def recorded_quantities(signals: Iterable[str]) -> list[MainQuantity]:
    """Main quantities whose signals are among the names."""
    names = set(signals)
    shape = shape_of(names)
    return [each for kind in SMALLEST for each in main_quantities(kind, shape) if each.signal in names]
