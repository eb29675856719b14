"""The main quantities by kind of machine, by path, and by the signals of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Final

from hilbench.topology.main_quantities import servo_axis, web_line
from hilbench.topology.main_quantities.quantity import MainQuantity

#: By kind of machine, in the order in which they are looked for in a recording.
MAIN_QUANTITIES: Final[dict[str, tuple[MainQuantity, ...]]] = {
    "web_line": web_line.QUANTITIES,
    "servo_axis": servo_axis.QUANTITIES,
}


@cache
def find_quantity(path: str) -> MainQuantity | None:
    """The main quantity with a path; None for one that is none, as a parameter of an effect."""
    return next((each for of_kind in MAIN_QUANTITIES.values() for each in of_kind if each.path == path), None)


def recorded_quantities(signals: Iterable[str]) -> list[MainQuantity]:
    """Those whose signals are among the names."""
    names = set(signals)
    return [each for of_kind in MAIN_QUANTITIES.values() for each in of_kind if each.signal in names]
