"""The pictures of a run: what they show (`chart`), and as SVG text that takes its colours from the page around it.

Colours are those of Okabe and Ito (Color Universal Design, 2008). Every colour is written as a CSS variable, text
and axes as the page's text colour, so that one picture reads on white, on dark and on paper.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from itertools import pairwise
from math import ceil
from typing import Any, Final, Literal

import numpy as np

from hilbench.apps.report.chart import BLUE, INK, PURPLE, VARIABLES, VERMILLION, Band, Chart, Curve, Mark
from hilbench.apps.report.panel import ShownRun, recorded_panels
from hilbench.apps.report.reduce import envelope, thinned
from hilbench.arrays import Array
from hilbench.results.recording import Recording
from hilbench.results.result import Histogram

_COLUMNS: Final = 700
_DOTS_PER_INCH: Final = 200
#: Axes whose extremes reach beyond so many times what the signals do for 99.8 % of the time are cut, and say so.
_CUT_BEYOND: Final = 4.0
#: Bands widen axes by so many times what the curves do, to either side (live.js has it, too).
_BAND_ROOM: Final = 2.0
#: What a zoom shows: from before a step to after it, s; and steps that get one on paper.
_ZOOM_BEFORE_S: Final = 0.1
ZOOM_AFTER_S: Final = 1.2
_MOST_ZOOMS: Final = 6
#: Axes beside each other.
_MOST_ACROSS: Final = 3
#: Steps up to this number have their text beside them, more their numbers.
_MOST_TEXTS: Final = 3
#: Texts above the axes that are nearer than this share of their width would overlap.
_TEXT_SHARE: Final = 0.025

#: What each colour of a picture is called in the page's style sheet.
CSS_COLOURS: Final = {colour: f"var({name})" for colour, name in VARIABLES.items()} | {INK: "currentColor"}

_STYLE: Final[dict[str, Any]] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": INK,
    "grid.alpha": 0.13,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "lines.linewidth": 1.4,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}

#: Formats of a picture that is a file of its own.
ImageFormat = Literal["svg", "png"]


@dataclass(frozen=True)
class Picture:
    """One picture: its title, what it shows in words, its axes, and what draws it on a figure of page width,
    `height_in` inches high (None where signals are missing). `name` keeps its identifiers apart from others'."""

    name: str
    title: str
    caption: str = ""
    charts: Sequence[Chart] = ()
    draw: Callable[[Any], list[DrawnAxes]] | None = None
    height_in: float = 0.0
    zoomed: bool = False  #: shown around each step, too
    alternative: str = ""  #: what it is to who can't see it, where the title is not enough

    @cached_property
    def svg(self) -> str:
        """SVG text whose colours are those of the page around it; "" where signals are missing."""
        if self.draw is None:
            return ""
        with self._figure() as figure:
            text = io.StringIO()
            figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
        return _for_page(text.getvalue(), self.name, self.alternative or self.title)

    def as_file(self, form: ImageFormat) -> bytes:
        """Picture as a file of its own: on white, its colours in it. Raises ValueError where signals are missing."""
        title = self.alternative or self.title
        meta = {"svg": {"Date": None, "Creator": None, "Title": title}, "png": {"Software": None}}
        with self._figure() as figure:
            image = io.BytesIO()
            figure.savefig(
                image, format=form, facecolor="white", bbox_inches="tight", dpi=_DOTS_PER_INCH, metadata=meta[form]
            )
        return image.getvalue()

    @contextmanager
    def _figure(self) -> Iterator[Any]:
        """A figure with the picture on it. Raises ValueError where signals are missing."""
        if self.draw is None:
            raise ValueError(f"a picture that can be drawn, {self.name} lacks signals")
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure

        # From matplotlib's own defaults, not the user's matplotlibrc: the same run gives the same picture anywhere.
        style: Any = {**dict(matplotlib.rcParamsDefault), **_STYLE, "svg.hashsalt": f"hilbench-{self.name}"}
        height_in = self.height_in
        with matplotlib.rc_context(style):
            figure = Figure(figsize=(7.6, height_in))
            FigureCanvasSVG(figure)
            figure.subplots_adjust(
                left=0.095, right=0.865, top=1 - 0.26 / height_in, bottom=0.46 / height_in, hspace=0.14
            )
            for panel in self.draw(figure):
                panel.write_names()
            yield figure


@dataclass
class DrawnAxes:
    """Draws the curves of one set of axes and puts their names at their right ends."""

    axes: Any
    columns: int = _COLUMNS
    names: list[tuple[str, str, float]] = field(default_factory=list)

    def line(self, curve: Curve) -> None:
        """A curve, thinned to what the eye can see, its name at its end; a noisy one as an area."""
        if curve.spread:
            x, low, high = envelope(curve.t_s, curve.values, self.columns)
            self.axes.fill_between(x, low, high, color=curve.colour, alpha=0.3, linewidth=0)
        else:
            x, y = thinned(curve.t_s, curve.values, self.columns)
            style: dict[str, Any] = {"linestyle": (0, curve.dash)} if curve.dash else {}
            self.axes.plot(x, y, color=curve.colour, linewidth=curve.width, alpha=curve.alpha, **style)
        known = curve.values[np.isfinite(curve.values)]
        if curve.name and len(known):
            self.names.append((curve.name, curve.colour, float(np.mean(known[-max(len(known) // 40, 1) :]))))

    def band(self, band: Band) -> None:
        """The area between two signals, as wide as it ever is."""
        x, low, _ = envelope(band.t_s, band.low, self.columns)
        _, _, high = envelope(band.t_s, band.high, self.columns)
        self.axes.fill_between(x, low, high, color=band.colour, alpha=band.alpha, linewidth=0)

    def limits(
        self, curves: Sequence[Curve], least: float, marks: Sequence[Mark] = (), bands: Sequence[Band] = ()
    ) -> None:
        """Show all that the curves do, and at least a height of `least`; what is far out is cut, and marked, but for
        what they do at a mark: that is what the picture is looked at for. Bands are shown whole unless they are so much
        wider that the curves could not be read."""
        shown = np.concatenate([curve.values[np.isfinite(curve.values)] for curve in curves])
        if not len(shown):
            return
        lowest, highest = float(np.min(shown)), float(np.max(shown))
        low, high = np.percentile(shown, [0.1, 99.9])
        at_marks = np.concatenate([np.empty(0), *(_values_at(mark, curve) for mark in marks for curve in curves)])
        low, high = np.min(at_marks, initial=low), np.max(at_marks, initial=high)
        cut = highest - lowest > _CUT_BEYOND * max(high - low, least)
        if not cut:
            low, high = lowest, highest
        room = _BAND_ROOM * max(high - low, least)
        edges = np.concatenate(
            [np.empty(0), *(edge[np.isfinite(edge)] for band in bands for edge in (band.low, band.high))]
        )
        low, high = max(np.min(edges, initial=low), low - room), min(np.max(edges, initial=high), high + room)
        middle, half = (low + high) / 2, max((high - low) / 2 * 1.12, least / 2, 1e-9 * abs(high), 1e-12)
        self.axes.set_ylim(middle - half, middle + half)
        if cut:
            for at, words, edge, value in (
                (0.985, "▲ cut: up to", "top", highest),
                (0.015, "▼ cut: down to", "bottom", lowest),
            ):
                if abs(value - middle) > half:
                    place: dict[str, Any] = {"transform": self.axes.transAxes, "ha": "right", "va": edge}
                    self.axes.text(0.99, at, f"{words} {value:.4g}", color=VERMILLION, **place)

    def write_names(self) -> None:
        """Names in their curve's colour beside the right end, moved apart where they would overlap."""
        low, high = self.axes.get_ylim()
        height_pt = self.axes.get_position().height * self.axes.figure.get_figheight() * 72
        gap = 11.5 / height_pt
        places = [min(max((end - low) / (high - low), 0.0), 1.0) for _, _, end in self.names]
        for (name, colour, _), place in zip(self.names, _apart(places, gap), strict=True):
            self.axes.text(
                1.012, place, name, color=colour, transform=self.axes.transAxes, va="center", ha="left", clip_on=False
            )


def _values_at(mark: Mark, curve: Curve) -> Array:
    """Values of a curve from a step or event on."""
    if mark.lasts:
        return np.empty(0)
    first, last = np.searchsorted(curve.t_s, (mark.start_s, mark.end_s + ZOOM_AFTER_S))
    values = curve.values[first:last]
    return values[np.isfinite(values)]


def _apart(places: Sequence[float], gap: float) -> list[float]:
    """The places, moved as little as needed so that neighbours are `gap` apart and all lie between 0 and 1."""
    order = sorted(range(len(places)), key=lambda index: places[index])
    moved = list(places)
    for before, after in pairwise(order):
        moved[after] = max(moved[after], moved[before] + gap)
    if order and moved[order[-1]] > 1:
        moved[order[-1]] = 1.0
        for before, after in reversed(list(pairwise(order))):
            moved[before] = min(moved[before], moved[after] - gap)
    return moved


# -- the pictures of a run --------------------------------------------------------------------------------------------


def run_pictures(recording: Recording, marks: Sequence[Mark] = (), reference: Array | None = None) -> list[Picture]:
    """The pictures of the experiment, those of its kind of machine, each of the signals the recording has.

    `reference`: estimate that the published synchronizer would have made of the run.
    """
    run = ShownRun.of(recording, [(mark.start_s, mark.end_s) for mark in marks], reference)
    return [
        drawn(Picture(each.name, each.title, each.words(run), each.charts(run), zoomed=each.zoomed), marks)
        for each in recorded_panels(recording).pictures
    ]


def zooms(pictures: Sequence[Picture], marks: Sequence[Mark]) -> list[Picture]:
    """Pictures of the surroundings of each step, for paper; the first steps of a run with many."""
    wanted = [picture for picture in pictures if picture.zoomed and picture.charts]
    found: list[Picture] = []
    steps = [mark for mark in marks if mark.number]
    for step, following in zip(steps, [*steps[1:], None], strict=False):
        if not wanted or len(found) == _MOST_ZOOMS:
            break
        until_s = step.end_s + ZOOM_AFTER_S
        if following is not None:
            until_s = max(min(until_s, following.start_s), step.end_s + 0.1)
        parts = {each.title: each.charts[0].part(step.start_s - _ZOOM_BEFORE_S, until_s) for each in wanted}
        parts = {title: chart for title, chart in parts.items() if chart.curves}
        if parts:
            title = f"Step {step.number}: {step.text}"
            picture = Picture(f"zoom{step.number}", title, "", list(parts.values()))
            found.append(drawn(picture, [step], side_by_side=list(parts)))
    return found


def draw_histogram(histogram: Histogram) -> Picture:
    """Lateness of SYNC over all cycles, logarithmic, so that the rare late one shows."""
    edges, counts = np.array(histogram.edges_us), np.array(histogram.counts, np.float64)

    def draw(figure: Any) -> list[DrawnAxes]:
        axes = figure.subplots()
        axes.stairs(counts, edges, baseline=0.5, fill=True, color=BLUE, alpha=0.8)
        axes.set_yscale("log")
        axes.set_ylim(0.5, max(counts.max(initial=1), 1) * 2)
        axes.set_xlabel("lateness of SYNC in µs")
        axes.set_ylabel("cycles")
        return []

    title = "Lateness of SYNC"
    caption = "Every cycle; logarithmic, so that the rare late one shows."
    return Picture("jitter", title, caption, draw=draw, height_in=2.2)


# -- drawing ---------------------------------------------------------------------------------------------------------


def drawn(picture: Picture, marks: Sequence[Mark] = (), *, side_by_side: Sequence[str] = ()) -> Picture:
    """The picture with its SVG: its axes one below the other, or `side_by_side`, in rows where they are many, with
    these titles then."""
    if not picture.charts:
        return picture
    count = len(picture.charts)
    across = min(count, _MOST_ACROSS) if side_by_side else 1
    down = ceil(count / across)

    def draw(figure: Any) -> list[DrawnAxes]:
        if side_by_side:
            figure.subplots_adjust(wspace=0.5 if across < _MOST_ACROSS else 1.0, hspace=0.5)
        grid = np.ravel(figure.subplots(down, across, sharex=not side_by_side))
        for unused in grid[count:]:
            unused.remove()
        columns = _COLUMNS // across
        panels = [
            _draw_chart(axes, chart, columns, marks) for axes, chart in zip(grid[:count], picture.charts, strict=True)
        ]
        for panel in panels if side_by_side else panels[-1:]:
            panel.axes.set_xlabel("time in s")
        if down > 1:
            for panel, title in zip(panels, side_by_side, strict=False):
                panel.axes.set_title(title, fontsize=9)
        _draw_marks(marks, panels, texts=not side_by_side)
        return panels

    height_in = 2.5 * down if side_by_side else 0.9 + 2.0 * count
    return replace(picture, draw=draw, height_in=height_in)


def _draw_chart(axes: Any, chart: Chart, columns: int, marks: Sequence[Mark]) -> DrawnAxes:
    panel = DrawnAxes(axes, columns)
    for band in chart.bands:
        panel.band(band)
    for curve in chart.curves:
        panel.line(curve)
    panel.limits(chart.curves, chart.least, marks, chart.bands)
    axes.set_xlim(*chart.extent_s)
    axes.set_ylabel(chart.y_label)
    return panel


def _draw_marks(marks: Sequence[Mark], panels: Sequence[DrawnAxes], *, texts: bool) -> None:
    """Every step and event as a line, every ramp as an area, in all axes; one path for all of a kind."""
    lines = {
        (0, (1, 1.5)): [mark.start_s for mark in marks if mark.number],
        (0, (4, 2, 1, 2)): [mark.start_s for mark in marks if not mark.number and not mark.lasts],
    }
    areas = [(mark.start_s, mark.end_s - mark.start_s) for mark in marks if mark.lasts]
    for panel in panels:
        over_axes = panel.axes.get_xaxis_transform()
        limits = panel.axes.get_xlim()
        if areas:
            style: dict[str, Any] = {"color": INK, "alpha": 0.05, "linewidth": 0, "transform": over_axes}
            panel.axes.broken_barh(areas, (0, 1), **style)
        for dash, times in lines.items():
            if times:
                x = np.repeat(times, 3)
                y = np.tile([0.0, 1.0, np.nan], len(times))
                panel.axes.plot(x, y, color=PURPLE, linewidth=1.0, linestyle=dash, transform=over_axes)
        panel.axes.set_xlim(limits)
    if texts:
        _write_texts([mark for mark in marks if not mark.lasts], panels[0].axes)


def _write_texts(marks: Sequence[Mark], axes: Any) -> None:
    """Write the events above the axes; of many the numbers, and of those that would overlap the first."""
    steps = sum(bool(mark.number) for mark in marks)
    first_s, last_s = axes.get_xlim()
    free_s = first_s
    for mark in marks:
        if mark.start_s < free_s:
            continue
        free_s = mark.start_s + (last_s - first_s) * _TEXT_SHARE
        axes.annotate(
            mark.text if steps <= _MOST_TEXTS or not mark.number else mark.number,
            (mark.start_s, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3),
            textcoords="offset points",
            color=PURPLE,
            ha="center",
            va="bottom",
        )


_NUMBER = re.compile(r"-?\d+\.\d{3,}")


def _for_page(svg: str, name: str, title: str) -> str:
    """The bare <svg> element: page colours, coordinates to a hundredth of a point, scaled to the page's width.

    Identifiers get the picture's name in front, as several pictures are in one page; the style element goes, as
    it would hold for the whole page.
    """
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<(metadata|style)\b.*?</\1>", "", body, flags=re.DOTALL)
    body = re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{name}-", body)
    body = re.sub(
        r'( d=")([^"]*)(")',
        lambda m: m[1] + _NUMBER.sub(lambda n: f"{float(n[0]):.2f}".rstrip("0").rstrip("."), m[2]) + m[3],
        body,
    )
    for colour, variable in CSS_COLOURS.items():
        body = body.replace(colour, variable)
    body = re.sub(r"font: (\d+)px [^;\"]*", r"font-size: \1px", body)
    head_end = body.index(">")
    head = re.sub(r' (width|height)="[^"]*"', "", body[:head_end])
    return f'{head} role="img" aria-label="{escape(title)}"{body[head_end:]}'
