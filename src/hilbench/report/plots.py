"""The pictures of a run, as SVG text that stands inside an HTML page and takes its colours from the page.

Colours are those of Okabe and Ito (Color Universal Design, 2008). Every colour is written as a CSS variable, text
and axes as the page's text colour, so that one picture reads on white, on dark and on paper.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.experiment.events import find_events
from hilbench.experiment.metrics import E_BAND, expected_v1_m_s, working_window
from hilbench.record.recording import Recording
from hilbench.record.result import Histogram
from hilbench.report.reduce import envelope, mean_velocity, moving_average, thinned

Array = NDArray[np.float64]

#: Time over which velocities and torques are averaged for the eye, s (the publication: 20 values, 20 ms apart).
SMOOTHING_S: Final = 0.4
_COLUMNS: Final = 700

INK: Final = "#010203"  # becomes the page's text colour
BLUE: Final = "#0072b2"
VERMILLION: Final = "#d55e00"
GREEN: Final = "#009e73"
SKY: Final = "#56b4e9"
ORANGE: Final = "#e69f00"
PURPLE: Final = "#cc79a7"
BROWN: Final = "#8c6d31"

#: What each colour of a picture is called in the page's style sheet.
CSS_COLOURS: Final = {
    INK: "currentColor",
    BLUE: "var(--blue)",
    VERMILLION: "var(--vermillion)",
    GREEN: "var(--green)",
    SKY: "var(--sky)",
    ORANGE: "var(--orange)",
    PURPLE: "var(--purple)",
}

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


@dataclass(frozen=True)
class Picture:
    """One picture: its title, what it shows in words, and the SVG; `svg` is "" where the signals are missing."""

    title: str
    caption: str
    svg: str


@dataclass
class Panel:
    """Draws the curves of one set of axes and puts their names at their right ends."""

    axes: Any
    t_s: Array
    names: list[tuple[str, str, float]] = field(default_factory=list)

    def line(self, values: Array, name: str, colour: str, **style: Any) -> None:
        """A curve, thinned to what the eye can see; `name` stands at its end."""
        x, y = thinned(self.t_s, values, _COLUMNS)
        self.axes.plot(x, y, color=colour, **style)
        self._name(values, name, colour)

    def spread(self, values: Array, name: str, colour: str) -> None:
        """A noisy signal as the area between its least and largest values."""
        x, low, high = envelope(self.t_s, values, _COLUMNS)
        self.axes.fill_between(x, low, high, color=colour, alpha=0.3, linewidth=0)
        self._name(values, name, colour)

    def band(self, low: Array, high: Array, colour: str, alpha: float) -> None:
        """The area between two smooth signals."""
        keep = np.unique(np.linspace(0, len(self.t_s) - 1, 2 * _COLUMNS).astype(int))
        self.axes.fill_between(self.t_s[keep], low[keep], high[keep], color=colour, alpha=alpha, linewidth=0)

    def limits(self, *signals: Array, part: slice, margin: float = 0.12, least: float = 0.0) -> None:
        """Show what these signals do in a part of the run, and at least a height of `least`."""
        shown = np.concatenate([signal[part] for signal in signals])
        shown = shown[np.isfinite(shown)]
        if len(shown):
            low, high = np.percentile(shown, [0.1, 99.9])
            middle, half = (low + high) / 2, max((high - low) / 2 * (1 + 2 * margin), least / 2, 1e-12)
            self.axes.set_ylim(middle - half, middle + half)

    def _name(self, values: Array, name: str, colour: str) -> None:
        known = values[np.isfinite(values)]
        if name and len(known):
            self.names.append((name, colour, float(np.mean(known[-max(len(known) // 40, 1) :]))))

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


def draw_pictures(recording: Recording, reference_Pa: Array | None = None) -> list[Picture]:
    """The four pictures of the experiment, each drawn from the signals the recording has.

    `reference_Pa`: what the published synchronizer would have made of the run.
    """
    return [
        draw_velocities(recording),
        draw_torques(recording),
        draw_elasticity(recording, reference_Pa),
        draw_tension(recording),
    ]


def draw_velocities(recording: Recording) -> Picture:
    """Velocities with their commands, and, a thousand times finer, what axis 1 runs faster than the line."""
    title = "Velocities"
    caption = (
        f"Velocities at the web, averaged over {SMOOTHING_S:g} s. Below: velocity of axis 1 minus line speed"
        " (axis 2), and what mass conservation asks for at the strain of the imitated web once it is steady."
    )
    if not {"x1_m", "x2_m"} <= recording.channels.keys():
        return Picture(title, caption, "")
    t_s, width = recording.time_s, _samples(recording)
    v1, v2 = (mean_velocity(t_s, _get(recording, name), width) for name in ("x1_m", "x2_m"))
    commands = [_get(recording, name) for name in ("v2_cmd_m_s", "v1_cmd_m_s") if name in recording]
    part = _inner_window(recording)

    def draw(figure: Any) -> list[Panel]:
        upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (1, 1.25)})
        whole, fine = Panel(upper, t_s), Panel(lower, t_s)
        whole.line(v2, "axis 2", VERMILLION, linewidth=2.6, alpha=0.8)
        whole.line(v1, "axis 1", BLUE, linewidth=1.3)
        for number, command in enumerate(commands):
            whole.line(command, "" if number else "commands", INK, linewidth=0.8, linestyle=(0, (4, 4)))
        upper.set_ylabel("velocity in m/s")
        difference = np.full_like(v1, np.nan)
        difference[part] = 1e3 * (v1 - v2)[part]
        shown = [difference]
        fine.line(difference, "axis 1 − line", BLUE)
        if {"strain_prev", "strain_true"} <= recording.channels.keys():
            asked = np.full_like(v1, np.nan)
            strains = _get(recording, "strain_prev"), moving_average(_get(recording, "strain_true"), width)
            asked[part] = 1e3 * (expected_v1_m_s(v2, *strains) - v2)[part]
            fine.line(asked, "mass balance", INK, linewidth=0.9, linestyle=(0, (4, 2)))
            shown.append(asked)
        fine.limits(*shown, part=part, least=0.05)
        lower.set_ylabel("v1 − line in mm/s")
        return [whole, fine]

    return Picture(title, caption, _svg(recording, draw, 4.3, "velocities", title))


def draw_torques(recording: Recording) -> Picture:
    """Torque of axis 2: measured, smoothed, simulated."""
    title = "Torque of axis 2"
    caption = (
        f"Motor torque of axis 2: measured (area: least to largest), averaged over {SMOOTHING_S:g} s, and simulated"
        " by the twin. Their difference is what the twin learns E from."
    )
    if "tau2_Nm" not in recording:
        return Picture(title, caption, "")
    measured = _get(recording, "tau2_Nm")

    def draw(figure: Any) -> list[Panel]:
        panel = Panel(figure.subplots(), recording.time_s)
        panel.spread(measured, "measured", SKY)
        panel.line(moving_average(measured, _samples(recording)), "averaged", BLUE)
        if "tau2_sim_Nm" in recording:
            panel.line(_get(recording, "tau2_sim_Nm"), "simulated", VERMILLION, linewidth=1.2)
        panel.axes.set_ylabel("torque in N·m")
        return [panel]

    return Picture(title, caption, _svg(recording, draw, 2.9, "torques", title))


def draw_elasticity(recording: Recording, reference_Pa: Array | None = None) -> Picture:
    """Young's modulus: true, estimated, and by the published method."""
    title = "Young’s modulus"
    caption = (
        f"Young’s modulus of the imitated web with a band of ±{100 * E_BAND:g} % (grey), and the twin’s estimate with"
        " a band of ±2 standard deviations where the twin states one."
    )
    if reference_Pa is not None:
        caption += " PID: what the published tracking simulation makes of the same measurements."
    if "E_sim_Pa" not in recording:
        return Picture(title, caption, "")
    estimate = _get(recording, "E_sim_Pa") / 1e6
    part = _inner_window(recording)

    def draw(figure: Any) -> list[Panel]:
        panel = Panel(figure.subplots(), recording.time_s)
        shown = [estimate]
        if "E_true_Pa" in recording:
            true = _get(recording, "E_true_Pa") / 1e6
            panel.band(true * (1 - E_BAND), true * (1 + E_BAND), INK, 0.16)
            panel.line(true, "true", INK, linewidth=1.1)
            shown.append(true)
        if "E_sd_Pa" in recording:
            deviation = _get(recording, "E_sd_Pa") / 1e6
            panel.band(estimate - 2 * deviation, estimate + 2 * deviation, VERMILLION, 0.25)
        if reference_Pa is not None:
            panel.line(reference_Pa / 1e6, "PID", SKY)
            shown.append(reference_Pa / 1e6)
        panel.line(estimate, "estimated", VERMILLION)
        panel.limits(*shown, part=part, margin=0.15)
        panel.axes.set_ylabel("E in N/mm²")
        return [panel]

    return Picture(title, caption, _svg(recording, draw, 2.9, "elasticity", title))


def draw_tension(recording: Recording) -> Picture:
    """Web tension: true, simulated, set-point."""
    title = "Web tension"
    caption = (
        "Tension of the imitated web, tension simulated by the twin (the virtual sensor that the controller sees),"
        " and set-point."
    )
    present = [name for name in ("F_true_N", "F_sim_N", "F_ref_N") if name in recording]
    if not present:
        return Picture(title, caption, "")
    styles: dict[str, tuple[str, str, dict[str, Any]]] = {
        "F_true_N": ("true", BLUE, {}),
        "F_sim_N": ("simulated", VERMILLION, {"linewidth": 1.2}),
        "F_ref_N": ("set-point", INK, {"linewidth": 0.9, "linestyle": (0, (4, 2))}),
    }
    part = _inner_window(recording)

    def draw(figure: Any) -> list[Panel]:
        panel = Panel(figure.subplots(), recording.time_s)
        for name in present:
            label, colour, style = styles[name]
            panel.line(_get(recording, name), label, colour, **style)
        panel.limits(*(_get(recording, name) for name in present), part=part, least=4.0)
        panel.axes.set_ylabel("tension in N")
        return [panel]

    return Picture(title, caption, _svg(recording, draw, 2.9, "tension", title))


def draw_histogram(histogram: Histogram) -> Picture:
    """Lateness of SYNC over all cycles, logarithmic, so that the rare late one shows."""
    edges, counts = np.array(histogram.edges_us), np.array(histogram.counts, np.float64)

    def draw(figure: Any) -> list[Panel]:
        axes = figure.subplots()
        axes.stairs(counts, edges, baseline=0.5, fill=True, color=BLUE, alpha=0.8)
        axes.set_yscale("log")
        axes.set_ylim(0.5, max(counts.max(initial=1), 1) * 2)
        axes.set_xlabel("lateness of SYNC in µs")
        axes.set_ylabel("cycles")
        return []

    title = "Lateness of SYNC"
    return Picture(
        title, "Every cycle; logarithmic, so that the rare late one shows.", render_picture(draw, 2.2, "jitter", title)
    )


def _get(recording: Recording, name: str) -> Array:
    return np.asarray(recording[name], np.float64)


def _samples(recording: Recording) -> int:
    return max(round(SMOOTHING_S / float(np.median(np.diff(recording.time_s)))), 1)


def _inner_window(recording: Recording) -> slice:
    """The working window less the smoothing at its ends; the whole run if there is none."""
    found = working_window(recording.time_s, recording["v2_cmd_m_s"]) if "v2_cmd_m_s" in recording else None
    if found is None:
        return slice(0, len(recording))
    half = 2 * _samples(recording)
    inner = slice(found.start + half, found.stop - half)
    return inner if inner.stop - inner.start > half else found


def _svg(recording: Recording, draw: Callable[[Any], list[Panel]], height_in: float, name: str, title: str) -> str:
    def with_time_axis(figure: Any) -> list[Panel]:
        panels = draw(figure)
        panels[-1].axes.set_xlabel("time in s")
        for panel in panels:
            panel.axes.set_xlim(recording.time_s[0], recording.time_s[-1])
        _mark_steps(recording, panels)
        return panels

    return render_picture(with_time_axis, height_in, name, title)


def _mark_steps(recording: Recording, panels: Sequence[Panel]) -> None:
    for step in (event for event in find_events(recording.channels) if event.kind == "step"):
        for panel in panels:
            panel.axes.axvline(step.start_s, color=PURPLE, linewidth=1.0, linestyle=(0, (1, 1.5)))
        panels[0].axes.annotate(
            str(step),
            (step.start_s, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3),
            textcoords="offset points",
            color=PURPLE,
            ha="center",
            va="bottom",
        )


def render_picture(draw: Callable[[Any], list[Panel]], height_in: float, name: str, title: str) -> str:
    """SVG text of what `draw` draws on a figure of page width; `name` keeps its identifiers apart from others'."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # From matplotlib's own defaults, not the user's matplotlibrc: the same run gives the same picture anywhere.
    style: Any = {**dict(matplotlib.rcParamsDefault), **_STYLE, "svg.hashsalt": f"hilbench-{name}"}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(7.6, height_in))
        FigureCanvasSVG(figure)
        figure.subplots_adjust(left=0.095, right=0.865, top=1 - 0.26 / height_in, bottom=0.46 / height_in, hspace=0.14)
        panels = draw(figure)
        for panel in panels:
            panel.write_names()
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return _for_page(text.getvalue(), name, title)


_NUMBER = re.compile(r"-?\d+\.\d{3,}")


def _for_page(svg: str, name: str, title: str) -> str:
    """The bare <svg> element: page colours, coordinates to a hundredth of a point, scaled to the page's width.

    Identifiers get the picture's name in front, as several pictures stand in one page; the style element goes, as
    it would hold for the whole page.
    """
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<(metadata|style)\b.*?</\1>", "", body, flags=re.DOTALL)
    body = re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{name}-", body)
    body = re.sub(r'( d=")([^"]*)(")', lambda m: m[1] + _NUMBER.sub(_hundredths, m[2]) + m[3], body)
    for colour, variable in CSS_COLOURS.items():
        body = body.replace(colour, variable)
    body = re.sub(r"font: (\d+)px [^;\"]*", r"font-size: \1px", body)
    head_end = body.index(">")
    head = re.sub(r' (width|height)="[^"]*"', "", body[:head_end])
    return f'{head} role="img" aria-label="{title}"{body[head_end:]}'


def _hundredths(match: re.Match[str]) -> str:
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")
