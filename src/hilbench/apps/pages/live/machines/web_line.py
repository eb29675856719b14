"""A line: what the web runs over, with the tension of each span."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from hilbench.apps.report.page import filled
from hilbench.apps.report.web_line_drawing import placed_rollers, web_path
from hilbench.arrays import Array
from hilbench.topology.config import BenchConfig

#: Pixels of a unit of the drawing, as far as a line of this length has room for them, and what is around it.
_LARGEST_PX, _LEAST_PX, _WIDE_PX = 130.0, 78.0, 1300.0
_ABOVE_PX, _BELOW_PX = 92.0, 96.0
#: What was taken to be in the spans at first is nearly gone (e^-8) when the web has run so many times their length.
_TIMES: Final = 8.0


def settled(config: BenchConfig, names: Sequence[str], first: Array, last: Array) -> bool:
    """True if the web has run through the line often enough between two samples."""
    at = names.index(f"x{config.shape.axes}_m")
    lengths_m = sum(config.web_line.span_length_m(span) for span in range(1, config.shape.spans + 1))
    return bool(abs(last[at] - first[at]) > _TIMES * lengths_m)


def drawing(config: BenchConfig) -> str:
    """Drawing of a bench with a web."""
    circles = placed_rollers(config.web_line)
    width = max(circle.x + circle.r for circle in circles) + 2.0
    unit = min(max(_WIDE_PX / width, _LEAST_PX), _LARGEST_PX)
    deepest = min(circle.y - circle.r for circle in circles)

    def at(x: float, y: float) -> tuple[float, float]:
        return (x + 1.0) * unit, _ABOVE_PX - y * unit

    return filled(
        "pages/web_line",
        width=width * unit,
        height=_ABOVE_PX - deepest * unit + _BELOW_PX,
        at=at,
        unit=unit,
        web=[at(*point) for point in web_path(circles, width - 1.0)],
        circles=circles,
        pairs=pairwise(circles),
        drives=list(config.drives),
        loads=list(zip(config.load_motors, config.loaded_axes, strict=True)),
        shape=config.shape,
        lengths_m={span: config.web_line.span_length_m(span) for span in range(1, config.web_line.span_count + 1)},
    )
