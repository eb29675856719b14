"""Paths of the quantities of a web line, and of those that each of its spans has on a line of several."""

from __future__ import annotations

import re

from hilbench.topology.signals import Shape

TENSION_SET_POINT = "tension_control.set_point_N"
TENSION_PROBE = "tension_control.probe"
WEB_BROKEN = "load.web.broken"
#: E of the emulated web, in all spans.
YOUNGS_MODULUS = "load.web.youngs_modulus_Pa"

_NUMBERED_SET_POINT = re.compile(r"tension_control\.span([1-9]\d{0,3})\.set_point_N")
_MODULUS = re.compile(r"load\.web\.span([1-9]\d{0,3})\.youngs_modulus_Pa")


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
