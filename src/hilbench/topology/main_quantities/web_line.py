"""A web line: its speed, the tension, the elasticity of the web."""

from __future__ import annotations

from typing import Final

from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_quantities import (
    YOUNGS_MODULUS,
    modulus_of_span,
    span_of_modulus,
    span_of_set_point,
    tension_set_point,
)
from hilbench.topology.web_line_signals import LINE_SPEED_SIGNAL


def line_speed(shape: Shape) -> MainQuantity:
    """Line speed: the last axis leads, by the radius of the web on it where that is a reel."""
    signal = LINE_SPEED_SIGNAL if shape.winds else f"v{shape.axes}_cmd_m_s"
    return MainQuantity(LINE_SPEED, "line speed", "line speed", "m/s", signal, "v")


def set_point(number: str = "") -> MainQuantity:
    """Set-point of the span of that number, as names have it (`Shape.numbered`)."""
    of = f" of span {number}" if number else ""
    return MainQuantity(
        tension_set_point(number),
        f"tension set-point{of}",
        f"set-point {number}".strip(),
        "N",
        f"F{number}_ref_N",
        number or "t",
        f"F{number}_sim_N",
        of=f"tension {number}".strip(),
    )


def modulus(number: str = "") -> MainQuantity:
    """E of the web in the span of that number, as names have it (`Shape.numbered`)."""
    of = f" in span {number}" if number else ""
    return MainQuantity(
        modulus_of_span(int(number)) if number else YOUNGS_MODULUS,
        f"E of the emulated web{of}",
        f"E{number}",
        "Pa",
        f"E{number}_true_Pa",
        f"f{number}" if number else "m",
        f"E{number}_sim_Pa",
        f"E{number}_sd_Pa",
        shown_unit="N/mm²",
        si_per_shown=1e6,
        emulated=True,
    )


def numbered(path: str) -> MainQuantity | None:
    """The set-point or E of one span, by its path; None for another path."""
    span = span_of_set_point(path)
    if span is not None:
        return set_point(span)
    span = span_of_modulus(path)
    return modulus(span) if span else None


def main_quantities(shape: Shape) -> tuple[MainQuantity, ...]:
    """Quantities of a line: E as it is estimated (of a recording without estimates: as it was), set-points, speed."""
    return (
        *(modulus(shape.numbered(span)) for span in shape.estimated or (1,)),
        *(set_point(shape.numbered(span)) for span in shape.controlled),
        line_speed(shape),
    )


MODULUS: Final = modulus()
#: The smallest bench with a web line.
SMALLEST: Final = Shape(2, ("load",), 1, (1,), (1,))
SPEED: Final = line_speed(SMALLEST)
