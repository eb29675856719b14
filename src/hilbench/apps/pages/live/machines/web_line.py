"""A line: what the web runs over, with the tension of each span, and the plots of tensions, E, torques and speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import cycle, pairwise
from typing import Final

from hilbench.apps.pages.live.history import Array
from hilbench.apps.pages.live.machines import svg
from hilbench.apps.pages.live.machines.panel import Panel, Plot, Spread, Trace
from hilbench.apps.report.chart import BLUE, BROWN, GREEN, INK, ORANGE, PURPLE, SKY, VERMILLION
from hilbench.apps.report.web_line_drawing import DrawnRoller, contact_points, placed_rollers
from hilbench.plant.web_line.stations import CarriageStation, Reel
from hilbench.topology.config import BenchConfig
from hilbench.topology.main_quantities.quantity import ESTIMATED, OF_THE_MODEL, MainQuantity
from hilbench.topology.main_quantities.web_line import modulus

#: Where a point of the drawing is, in pixels.
Place = Callable[[float, float], tuple[float, float]]

_COLOURS: Final = (BLUE, GREEN, ORANGE, PURPLE, BROWN, SKY)
_DASHED: Final = (4.0, 3.0)
#: Pixels of a unit of the drawing, as far as a line of this length has room for them, and what is around it.
_LARGEST_PX, _LEAST_PX, _WIDE_PX = 130.0, 78.0, 1300.0
_ABOVE_PX, _BELOW_PX = 92.0, 96.0
#: What was taken to be in the spans at first is nearly gone (e^-8) when the web has run so many times their length.
_TIMES: Final = 8.0


def panel(config: BenchConfig) -> Panel:
    """Plots and drawing of a bench with a web."""
    plots = (*_tensions(config), *_moduli(config), _torques(config), _speeds(config), _residuals(config))
    return Panel([plot for plot in plots if plot.traces], _drawing(config))


def settled(config: BenchConfig, names: Sequence[str], first: Array, last: Array) -> bool:
    """True if the web has run through the line often enough between two samples."""
    at = names.index(f"x{config.shape.axes}_m")
    lengths_m = sum(config.web_line.span_length_m(span) for span in range(1, config.shape.spans + 1))
    return bool(abs(last[at] - first[at]) > _TIMES * lengths_m)


def _tensions(config: BenchConfig) -> Iterator[Plot]:
    shape, limits = config.shape, config.safety.limits
    for span in range(1, shape.spans + 1):
        k = shape.numbered(span)
        traces = [Trace(f"F{k}_true_N", "true", BLUE)]
        if span in shape.simulated:
            traces.append(Trace(f"F{k}_sim_N", "simulated", VERMILLION, 1.2))
        if span in shape.controlled:
            traces.append(Trace(f"F{k}_ref_N", "set-point", INK, 0.9, _DASHED))
        title = f"Web tension in span {span}" if shape.spans > 1 else "Web tension"
        yield Plot(f"tension{k}", title, "N", traces, least=4.0, limits=limits.tension_N)


def _moduli(config: BenchConfig) -> Iterator[Plot]:
    shape = config.shape
    for span in shape.estimated:
        quantity = modulus(shape.numbered(span))
        yield Plot(
            f"modulus{shape.numbered(span)}",
            f"Young’s modulus in span {span}" if shape.spans > 1 else "Young’s modulus",
            quantity.in_unit,
            (Trace(quantity.signal, "true", INK, 1.1), *_of_twin(quantity, shape.has_stations)),
            (Spread(quantity.twin_signal, quantity.twin_deviation, VERMILLION),),
            si_per_unit=quantity.si_per_shown,
            least=100.0,
        )


def _of_twin(quantity: MainQuantity, may_be_untold: bool) -> Iterator[Trace]:
    """Traces of the twin's value of a quantity: estimated, and its model's where it is not identifiable."""
    if not may_be_untold:
        yield Trace(quantity.twin_signal, ESTIMATED, VERMILLION)
        return
    for name, told in ((ESTIMATED, True), (OF_THE_MODEL, False)):
        dash = () if told else _DASHED
        yield Trace(quantity.twin_signal, name, VERMILLION, dash=dash, deviation=quantity.twin_deviation, told=told)


def _torques(config: BenchConfig) -> Plot:
    shape = config.shape
    axes = [
        Trace(f"tau{axis}_Nm", f"axis {axis}", colour, 0.9)
        for axis, colour in zip(range(1, shape.axes + 1), cycle(_COLOURS), strict=False)
    ]
    simulated = [
        Trace(f"tau{axis}_sim_Nm", f"axis {axis} simulated", VERMILLION, 1.2)
        for axis in (shape.axis_before(span) + 1 for span in shape.estimated)
    ]
    loads = [Trace(f"tau_{name}_Nm", name, BROWN, 0.9) for name in config.load_motors]
    limits = config.safety.limits.torque_Nm
    return Plot("torque", "Torques", "N·m", (*axes, *simulated, *loads), least=0.5, limits=limits)


def _speeds(config: BenchConfig) -> Plot:
    axes = range(1, config.shape.axes + 1)
    traces = [
        *(Trace(f"v{axis}_m_s", f"axis {axis}", colour) for axis, colour in zip(axes, cycle(_COLOURS), strict=False)),
        *(Trace(f"v{axis}_cmd_m_s", f"command {axis}", INK, 0.8, _DASHED) for axis in axes),
    ]
    return Plot("speed", "Speeds at the web", "m/s", traces, least=0.1, limits=config.safety.limits.speed_m_s)


def _residuals(config: BenchConfig) -> Plot:
    shape = config.shape
    behind = [shape.axis_before(span) + 1 for span in shape.estimated]
    traces = [
        Trace(f"tau{axis}_residual_Nm", f"axis {axis}", colour, 0.9)
        for axis, colour in zip(behind, cycle(_COLOURS), strict=False)
    ]
    return Plot("residual", "Residual: torque measured less simulated", "N·m", traces, least=0.1)


# -- the drawing ------------------------------------------------------------------------------------------------------


def _drawing(config: BenchConfig) -> str:
    circles = placed_rollers(config.web_line)
    width = max(circle.x + circle.r for circle in circles) + 2.0
    unit = min(max(_WIDE_PX / width, _LEAST_PX), _LARGEST_PX)
    deepest = min(circle.y - circle.r for circle in circles)

    def at(x: float, y: float) -> tuple[float, float]:
        return (x + 1.0) * unit, _ABOVE_PX - y * unit

    shapes: list[str] = []
    points = [point for circle in circles for point in contact_points(circle)]
    first, last = circles[0], circles[-1]
    web = [(-1.0, first.y + first.r), *points, (width - 1.0, last.y + last.r)]
    ends = slice(int(_is_reel(first)), len(web) - int(_is_reel(last)))
    shapes.append(svg.line([at(*point) for point in web[ends]], "web"))
    for circle in circles:
        shapes += _roller(config, circle, at(circle.x, circle.y), unit)
    for before, behind in pairwise(circles):
        shapes += _span(config, before, behind, at)
    return svg.picture(width * unit, _ABOVE_PX - deepest * unit + _BELOW_PX, "The line", shapes)


def _is_reel(circle: DrawnRoller) -> bool:
    return isinstance(circle.roller.station, Reel)


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
