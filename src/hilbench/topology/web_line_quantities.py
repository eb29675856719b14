"""Paths of the quantities of a web line, and of those that each of its spans has on a line of several.

Of the position loop of a dancer or accumulator `position_control.store.set_point_m` is where the carriage of `store` is
to stand; `position_control.store.feed` is 1 while the axis before it feeds the line by the loop, 0 for it to stand, as
a reel that is changed, while the accumulator feeds the line. Where the force on the carriage is fed forward
`position_control.store.force.set_point_N` is the tension behind it that the force is to keep.
"""

from __future__ import annotations

import re
from typing import Final

from hilbench.topology.signals import Shape

TENSION_SET_POINT = "tension_control.set_point_N"
TENSION_PROBE = "tension_control.probe"
WEB_BROKEN = "load.web.broken"
#: E of the emulated web, in all spans.
YOUNGS_MODULUS = "load.web.youngs_modulus_Pa"

_NUMBERED_SET_POINT = re.compile(r"tension_control\.span([1-9]\d{0,3})\.set_point_N")
_MODULUS = re.compile(r"load\.web\.span([1-9]\d{0,3})\.youngs_modulus_Pa")


SET_POINT: Final = "set_point_m"
FEED: Final = "feed"
FORCE_SET_POINT: Final = "force.set_point_N"

_PATH: Final = re.compile(rf"position_control\.([A-Za-z]\w*)\.({SET_POINT}|{FEED}|{re.escape(FORCE_SET_POINT)})")


def tension_set_point(number: str) -> str:
    """The path of the set-point of a span's tension; `number`: that of the span as names have it (`Shape.numbered`)."""
    return f"tension_control.span{number}.set_point_N" if number else TENSION_SET_POINT


def span_of_set_point(path: str) -> str | None:
    """The number of the span in the path of a set-point of a tension, "" where it has none; None for another path."""
    found = _NUMBERED_SET_POINT.fullmatch(path)
    return found[1] if found else "" if path == TENSION_SET_POINT else None


def without_number(path: str) -> str:
    """Path of the quantity of which a span has its own; another path as it is."""
    if span_of_set_point(path):
        return TENSION_SET_POINT
    return YOUNGS_MODULUS if is_modulus(path) else path


def several(shape: Shape) -> dict[str, list[str]]:
    """Paths of the parts of a line that have a quantity, by its path without a number."""
    return {
        TENSION_SET_POINT: [tension_set_point(shape.numbered(span)) for span in shape.controlled],
        YOUNGS_MODULUS: list(spans_of_moduli(shape)),
    }


def modulus_of_span(span: int) -> str:
    """The path of E of one span, from 1."""
    return f"load.web.span{span}.youngs_modulus_Pa"


def span_of_modulus(path: str) -> str:
    """The number of the span in the path of E of one span; "" for another path."""
    found = _MODULUS.fullmatch(path)
    return found[1] if found else ""


def is_modulus(path: str) -> bool:
    """True if a path is that of E of one span."""
    return span_of_modulus(path) != ""


def spans_of_moduli(shape: Shape) -> dict[str, int]:
    """The span of each path of E on a line: of that of all spans the first; of several also the path of each."""
    spans = range(1, shape.spans + 1) if shape.spans > 1 else ()
    return {YOUNGS_MODULUS: 1, **{modulus_of_span(span): span for span in spans}}


def alike(path: str) -> tuple[str, ...]:
    """The paths under which a quantity may have been set: E of a span also with that of all."""
    return (path, YOUNGS_MODULUS) if is_modulus(path) else (path,)


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
