"""The main quantities of a machine, by path, and by the signals of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from hilbench.machine_kinds import machine_part
from hilbench.topology.main_quantities import web_line
from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.signals import Shape, shape_of, smallest_shapes


def main_quantities(kind: str, shape: Shape) -> tuple[MainQuantity, ...]:
    """Main quantities of a kind of machine with these parts."""
    found: tuple[MainQuantity, ...] = machine_part(kind, "topology").main_quantities(shape)
    return found


@cache
def find_quantity(path: str) -> MainQuantity | None:
    """The main quantity with a path; None for one that is none, as a parameter of an effect."""
    numbered = web_line.numbered(path)
    if numbered is not None:
        return numbered
    known = (each for kind, shape in smallest_shapes().items() for each in main_quantities(kind, shape))
    return next((each for each in known if each.path == path), None)


def recorded_quantities(signals: Iterable[str]) -> list[MainQuantity]:
    """Main quantities whose signals are among the names."""
    names = set(signals)
    shape = shape_of(names)
    return [each for kind in smallest_shapes() for each in main_quantities(kind, shape) if each.signal in names]
