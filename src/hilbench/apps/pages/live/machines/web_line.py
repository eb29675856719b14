"""A line: what the web runs over, with the tension of each span."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Final

from hilbench.apps.pages.live.machines import svg
from hilbench.apps.report.web_line_drawing import DrawnRoller, placed_rollers, web_path
from hilbench.arrays import Array
from hilbench.plant.web_line.stations import CarriageStation
from hilbench.topology.config import BenchConfig

#: Where a point of the drawing is, in pixels.
Place = Callable[[float, float], tuple[float, float]]

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

    shapes: list[str] = []
    shapes.append(svg.line([at(*point) for point in web_path(circles, width - 1.0)], "web"))
    for circle in circles:
        shapes += _roller(config, circle, at(circle.x, circle.y), unit)
    for before, behind in pairwise(circles):
        shapes += _span(config, before, behind, at)
    return svg.picture(width * unit, _ABOVE_PX - deepest * unit + _BELOW_PX, "The line", shapes)


def _roller(config: BenchConfig, circle: DrawnRoller, centre: tuple[float, float], unit: float) -> Iterator[str]:
    (x, y), r, axis = centre, circle.r * unit, circle.roller.axis
    if axis is None:
        yield svg.circle(x, y, r, "idler")
        if not isinstance(circle.roller.station, CarriageStation):
            yield svg.text(x, y + r + 18.0, circle.roller.name, "faint")
        elif circle.hangs:
            yield svg.text(x, y + r + 18.0, circle.roller.station.name, "faint")
        return
    name = list(config.drives)[axis - 1]
    yield svg.part(name, (svg.circle(x, y, r, "roller"), svg.circle(x, y, 5.0, "hub")))
    for load, loaded in zip(config.load_motors, config.loaded_axes, strict=True):
        if loaded == axis:
            yield svg.part(load, (svg.circle(x, y, 0.55 * r, "load"),))
    below = y + r + 18.0
    yield svg.text(x, below, name, "name")
    yield svg.value(x, below + 18.0, f"v{axis}_m_s", "m/s")
    yield svg.value(x, below + 36.0, f"tau{axis}_Nm", "N·m")
    if axis in config.loaded_axes:
        load = config.load_motor_of(axis)
        yield svg.value(x, below + 54.0, f"tau_{load}_Nm", "N·m", kind="faint", before=f"{load} ")


def _span(config: BenchConfig, before: DrawnRoller, behind: DrawnRoller, at: Place) -> Iterator[str]:
    """Tension and E of the web between two rollers, where there is room for them."""
    if behind.span != before.span + 1 or before.hangs or behind.hangs:
        return
    span, shape = before.span, config.shape
    k = shape.numbered(span)
    x, y = at(0.5 * (before.x + before.r + behind.x - behind.r), 0.0)
    length = f"{config.web_line.span_length_m(span):g} m"
    yield svg.text(x, y - 62.0, f"span {span}, {length}" if shape.spans > 1 else f"span, {length}", "faint")
    yield svg.value(x, y - 40.0, f"F{k}_true_N", "N", kind="true", before="true ")
    if span in shape.simulated:
        yield svg.value(x, y - 20.0, f"F{k}_sim_N", "N", kind="simulated", before="simulated ")
    if span in shape.controlled:
        yield svg.value(x, y + 24.0, f"F{k}_ref_N", "N", kind="faint", before="set-point ")
    if span in shape.estimated:
        yield svg.value(x, y + 44.0, f"E{k}_sim_Pa", "N/mm²", kind="simulated", per=1e6, before="E ")
