"""A drawing of a web line from its topology: what the web runs over, the spans between, and their tensions.

Lengths are not to scale. Driven rollers have a dot, with a ring where a load motor is on the shaft; idlers are empty;
the roller of a dancer hangs under its neighbours, those of an accumulator hang by turns, and of many strands four are
drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, pi, sin
from pathlib import Path
from typing import Any, Final

import numpy as np

from hilbench.apps.report.chart import BLUE, INK, ORANGE, VERMILLION
from hilbench.apps.report.plots import DrawnAxes, Picture
from hilbench.errors import UnusableInputError
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import CarriageStation, Dancer, LineRoller, Reel
from hilbench.results.recording import Recording
from hilbench.runs.config import load_with_overrides
from hilbench.runs.figures import working_window
from hilbench.topology.config import BenchConfig
from hilbench.topology.main_quantities.web_line import line_speed
from hilbench.topology.signals import shape_of

_TITLE: Final = "The line"
_CAPTION: Final = (
    "What the web runs over, in its direction; the tensions of the emulated web are means over the last second at "
    "working speed, with their set-points. Dot: driven; ring: a load motor on the shaft. Not to scale."
)
#: Sizes in units of the drawing, which is as wide as the line is long.
_DRIVEN, _IDLER, _REEL, _FREE, _HANGS = 0.34, 0.2, 0.62, 2.5, 1.8
#: A shorter line is in the middle: its rollers are no larger than those of others.
_NARROWEST: Final = 9.0
_MOST_STRANDS: Final = 4
_MEAN_S: Final = 1.0


@dataclass(frozen=True)
class LineNotes:
    """Notes beside a line: names of its driven axes, which of them carry load motors, and by span, from 1,
    tensions and set-points in N."""

    axes: Sequence[str] = ()
    loaded: Sequence[int] = ()
    tensions_N: Mapping[int, float] = field(default_factory=dict)
    set_points_N: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DrawnRoller:
    roller: LineRoller
    x: float
    y: float
    r: float
    hangs: bool
    before_hanging: bool  #: the web comes up, or goes down, beside it
    behind_hanging: bool
    span: int  #: the one behind it

    @property
    def on_carriage(self) -> bool:
        """True if it is one of a dancer or an accumulator."""
        return isinstance(self.roller.station, CarriageStation)

    @property
    def is_reel(self) -> bool:
        """True if the web ends on it."""
        return isinstance(self.roller.station, Reel)


def line_picture(config: Path, recording: Recording) -> list[Picture]:
    """The drawing of a run's line; none for another machine, or a config too old to be understood."""
    try:
        bench = load_with_overrides(config).config
    except UnusableInputError:
        return []
    if bench.machine.kind != "web_line":
        return []
    return [drawing(bench.web_line, _notes(bench, recording))]


def _notes(bench: BenchConfig, recording: Recording) -> LineNotes:
    numbers = {span: bench.shape.numbered(span) for span in range(1, bench.web_line.span_count + 1)}
    command = line_speed(shape_of(recording.channels)).signal
    window = working_window(recording.time_s, recording[command]) if command in recording else None
    end = window.stop if window is not None else len(recording)
    time_s = recording.time_s[:end]
    last = slice(int(np.searchsorted(time_s, time_s[-1] - _MEAN_S)), end) if end else slice(0, 0)
    means = {
        span: float(np.nanmean(np.asarray(recording[name], float)[last]))
        for span, number in numbers.items()
        if end and (name := f"F{number}_true_N") in recording and np.any(np.isfinite(recording[name][last]))
    }
    wanted = {
        span: float(recording[name][end - 1])
        for span, number in numbers.items()
        if end and (name := f"F{number}_ref_N") in recording
    }
    return LineNotes(tuple(bench.drives), bench.loaded_axes, means, wanted)


def drawing(model: ModelParameters, notes: LineNotes) -> Picture:
    """The picture of a line with a web. Raises ValueError for a model without one."""
    circles = placed_rollers(model)
    width = max(circle.x + circle.r for circle in circles) + 1.0
    beside = max(_NARROWEST - width, 0.0) / 2.0
    deepest = min(circle.y for circle in circles)
    low, high = deepest - 1.35, 0.6

    def draw(figure: Any) -> list[DrawnAxes]:
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        axes.set_aspect("equal")
        axes.set_xlim(-1.0 - beside, width + beside)
        axes.set_ylim(low, high)
        axes.plot(*np.array(web_path(circles, width)).T, color=BLUE, linewidth=1.8)
        for circle in circles:
            _draw_roller(axes, circle, notes)
        for before, behind in pairwise(circles):
            _write_span(axes, model, notes, before, behind)
        for station in {id(c.roller.station): c.roller.station for c in circles if c.hangs}.values():
            _draw_carriage(axes, [c for c in circles if c.hangs and c.roller.station is station])
        return []

    height_in = float(np.clip(7.6 * (high - low) / (width + 1.0 + 2.0 * beside), 1.2, 3.2))
    return Picture("line", _TITLE, _CAPTION, draw=draw, height_in=height_in)


def placed_rollers(model: ModelParameters) -> list[DrawnRoller]:
    """The rollers that are drawn, in their places."""
    shown: list[tuple[LineRoller, bool, int]] = []
    number_in_station: dict[int, int] = {}
    for span, roller in enumerate(model.line_rollers, 1):
        hangs = False
        if isinstance(roller.station, CarriageStation):
            number = number_in_station[id(roller.station)] = number_in_station.get(id(roller.station), 0) + 1
            if number > _MOST_STRANDS - 1:
                continue
            hangs = number % 2 == 1
        shown.append((roller, hangs, span))
    placed: list[DrawnRoller] = []
    x = 0.0
    for number, (roller, hangs, span) in enumerate(shown):
        r = _REEL if isinstance(roller.station, Reel) else _DRIVEN if roller.axis is not None else _IDLER
        before_hangs = number > 0 and shown[number - 1][1]
        behind_hangs = number + 1 < len(shown) and shown[number + 1][1]
        if placed:
            beside = hangs or before_hangs
            x += placed[-1].r + r + (0.0 if beside else _FREE)
        placed.append(DrawnRoller(roller, x, -_HANGS if hangs else -r, r, hangs, before_hangs, behind_hangs, span))
    return placed


def web_path(circles: Sequence[DrawnRoller], end: float) -> list[tuple[float, float]]:
    """Points of the web, which goes on to `end` unless it is wound there, and comes from -1 unless it is unwound."""
    first, last = circles[0], circles[-1]
    points = [point for circle in circles for point in _contact_points(circle)]
    coming = [] if first.is_reel else [(-1.0, first.y + first.r)]
    return [*coming, *points, *([] if last.is_reel else [(end, last.y + last.r)])]


def _contact_points(circle: DrawnRoller) -> list[tuple[float, float]]:
    """Points at which the web touches a roller, in its direction."""
    if circle.hangs:
        angles = np.linspace(pi, 2 * pi, 13)
    else:
        angles = np.linspace(pi if circle.before_hanging else 0.5 * pi, 0.0 if circle.behind_hanging else 0.5 * pi, 13)
    return [(circle.x + circle.r * cos(angle), circle.y + circle.r * sin(angle)) for angle in angles]


def _draw_roller(axes: Any, circle: DrawnRoller, notes: LineNotes) -> None:
    from matplotlib.patches import Circle

    centre, axis = (circle.x, circle.y), circle.roller.axis
    axes.add_patch(Circle(centre, circle.r, fill=False, edgecolor=INK, linewidth=1.1))
    if circle.is_reel:
        for share in (0.45, 0.63, 0.81):
            axes.add_patch(Circle(centre, share * circle.r, fill=False, edgecolor=INK, linewidth=0.5, alpha=0.6))
    name = "" if circle.on_carriage else circle.roller.name
    if axis is not None:
        axes.add_patch(Circle(centre, 0.07, facecolor=INK, edgecolor="none"))
        if axis in notes.loaded:
            axes.add_patch(Circle(centre, 0.17, fill=False, edgecolor=ORANGE, linewidth=1.6))
        known = circle.roller.station.type if isinstance(circle.roller.station, Reel) else "axis"
        name = f"{axis} {notes.axes[axis - 1]}" if axis <= len(notes.axes) else f"{known} {axis}"
    axes.text(circle.x, circle.y - circle.r - 0.12, name, ha="center", va="top", fontsize=8)


def _write_span(axes: Any, model: ModelParameters, notes: LineNotes, before: DrawnRoller, behind: DrawnRoller) -> None:
    """Number, length and tension; of strands beside each other at their middle, of those left out nothing."""
    if behind.span != before.span + 1 and not before.hangs:
        return
    span = before.span
    words = [f"span {span}, {model.span_length_m(span):g} m"]
    if span in notes.tensions_N:
        words.append(f"{notes.tensions_N[span]:.1f} N")
    if span in notes.set_points_N:
        words.append(f"(set-point {notes.set_points_N[span]:g} N)")
    free = not (before.hangs or behind.hangs)
    if free:
        x = 0.5 * (before.x + before.r + behind.x - behind.r)
        axes.text(x, 0.12, words[0], ha="center", va="bottom", fontsize=8)
        axes.text(x, -0.12, "\n".join(words[1:]), ha="center", va="top", fontsize=8, color=VERMILLION)
        return
    leftmost = behind.hangs and not before.before_hanging
    if leftmost or (before.hangs and not behind.behind_hanging):
        x, side = (before.x + 0.1, "right") if leftmost else (behind.x - 0.1, "left")
        number = span if leftmost else behind.span - 1
        text = f"span {number}" + "".join(f"\n{notes.tensions_N[n]:.1f} N" for n in (number,) if n in notes.tensions_N)
        beside = before if leftmost else behind
        # A reel reaches so far down that its name is there.
        y = beside.y - beside.r - 0.62 if beside.is_reel else -0.75 * _HANGS
        axes.text(x, y, text, ha=side, va="center", fontsize=8, color=VERMILLION)


def _draw_carriage(axes: Any, hanging: Sequence[DrawnRoller]) -> None:
    """Draw the carriage of the hanging rollers, its name, and the direction which lengthens the web."""
    station = hanging[0].roller.station
    assert isinstance(station, CarriageStation)
    low, left, right = hanging[0].y, hanging[0].x, hanging[-1].x
    bottom = low - _IDLER - 0.16
    axes.plot([left - 0.15, right + 0.15], [bottom, bottom], color=INK, linewidth=1.6)
    for circle in hanging:
        axes.plot([circle.x, circle.x], [circle.y, bottom], color=INK, linewidth=0.8)
    middle = 0.5 * (left + right)
    arrow = {"arrowstyle": "->", "color": INK, "linewidth": 0.9}
    axes.annotate("", (middle, bottom - 0.42), (middle, bottom), arrowprops=arrow)
    kind = "" if isinstance(station, Dancer) else f", {station.strand_count} strands"
    axes.text(middle, bottom - 0.48, f"{station.name}{kind}", ha="center", va="top", fontsize=8)
