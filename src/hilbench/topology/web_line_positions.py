"""Paths of what can be set of the position loop of a dancer or accumulator.

`position_control.store.set_point_m` is where the carriage of `store` is to stand; `position_control.store.feed` is 1
while the axis before it feeds the line by the loop, 0 for it to stand, as a reel that is changed, while the
accumulator feeds the line. Where the force on the carriage is fed forward `position_control.store.force.set_point_N` is
the tension behind it that the force is to keep.
"""

from __future__ import annotations

import re
from typing import Final

SET_POINT: Final = "set_point_m"
FEED: Final = "feed"
FORCE_SET_POINT: Final = "force.set_point_N"

_PATH: Final = re.compile(rf"position_control\.([A-Za-z]\w*)\.({SET_POINT}|{FEED}|{re.escape(FORCE_SET_POINT)})")


def position_path(station: str, quantity: str) -> str:
    """The path of a quantity of the loop of a station."""
    return f"position_control.{station}.{quantity}"


def position_quantity(path: str) -> str:
    """Quantity of a position loop that a path names; "" for another path."""
    found = _PATH.fullmatch(path)
    return found[2] if found else ""


def positions(stations: tuple[str, ...], pushed: tuple[str, ...]) -> list[str]:
    """The paths of the loops of these stations; `pushed`: those of them whose force is fed forward."""
    paths = [position_path(station, quantity) for station in stations for quantity in (SET_POINT, FEED)]
    return [*paths, *(position_path(station, FORCE_SET_POINT) for station in pushed)]
