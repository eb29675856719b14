"""Paths of the quantities that each span of an emulated web has, on a line of several."""

from __future__ import annotations

import re

from hilbench.topology.signals import Shape

#: E of the emulated web, in all spans.
YOUNGS_MODULUS = "load.web.youngs_modulus_Pa"

_MODULUS = re.compile(r"load\.web\.span([1-9]\d{0,3})\.youngs_modulus_Pa")


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


def moduli(shape: Shape) -> list[str]:
    """The paths of E of each span of a line; none where there is one span."""
    return [modulus_of_span(span) for span in range(1, shape.spans + 1)] if shape.spans > 1 else []


def alike(path: str) -> tuple[str, ...]:
    """The paths under which a quantity may have been set: E of a span also with that of all."""
    return (path, YOUNGS_MODULUS) if is_modulus(path) else (path,)
