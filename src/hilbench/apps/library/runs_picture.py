"""A metric over runs, as a picture: over the time at which they began, or over a value in which they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hilbench.apps.library.index import RunEntry
from hilbench.apps.library.query import values_of
from hilbench.apps.report.chart import BLUE, GREEN, INK, VERMILLION
from hilbench.apps.report.plots import DrawnAxes, ImageFormat, Picture
from hilbench.errors import UnusableInputError
from hilbench.files import written_whole

_HEIGHT_IN: Final = 3.2
#: The line goes through the medians of so many runs to both sides of each: at least, and as a share of all.
_BESIDE: Final = 5
_BESIDE_SHARE: Final = 0.03
_LEAST_FOR_A_LINE: Final = 8
#: Time in which a run began.
BEGAN: Final = "began"


@dataclass(frozen=True)
class Point:
    """A run: its value of the metric at `x` (s since 1970, or the value of a key)."""

    run: RunEntry
    x: float
    value: float


def points_of(runs: Sequence[RunEntry], metric: str, over: str = BEGAN) -> list[Point]:
    """Points of the runs that have both, by `over`. Raises UnusableInputError where it is no number."""
    found = []
    for run in runs:
        known = values_of(run, [metric, over])
        x, value = run.began_s if over == BEGAN else known.get(over), known.get(metric)
        for name, given in ((over, x), (metric, value)):
            if given is not None and (isinstance(given, bool) or not isinstance(given, int | float)):
                raise UnusableInputError(name, f"is {given!r} in {run.path}, expected a number in each run")
        if x is not None and value is not None:
            found.append(Point(run, float(x), float(value)))
    return sorted(found, key=lambda point: point.x)


def medians(points: Sequence[Point]) -> list[float]:
    """Medians of the runs around each; none of few runs."""
    if len(points) < _LEAST_FOR_A_LINE:
        return []
    values = np.array([point.value for point in points])
    beside = max(_BESIDE, round(_BESIDE_SHARE * len(values)))
    return [float(np.median(values[max(at - beside, 0) : at + beside + 1])) for at in range(len(values))]


def draw_runs(points: Sequence[Point], metric: str, over: str = BEGAN) -> Picture:
    """A point a run, in the colour of its result, and a line through the medians of neighbours."""

    def draw(figure: Any) -> list[DrawnAxes]:
        axes = figure.subplots()
        panel = DrawnAxes(axes)
        of_state = {"passed": ("passed", GREEN), "completed": ("nothing judged", BLUE)}
        groups: dict[tuple[str, str], list[Point]] = {}
        for point in points:
            groups.setdefault(of_state.get(point.run.state, ("not passed", VERMILLION)), []).append(point)
        for (name, colour), shown in sorted(groups.items(), reverse=True):
            if shown:
                axes.plot([_at(p, over) for p in shown], [p.value for p in shown], "o", color=colour, markersize=3.4)
                panel.names.append((name, colour, float(np.median([p.value for p in shown]))))
        line = medians(points)
        if line:
            axes.plot([_at(point, over) for point in points], line, color=INK, linewidth=1.1)
            panel.names.append(("median", INK, line[-1]))
        axes.set_xlabel("" if over == BEGAN else over)
        axes.set_ylabel(metric)
        if over == BEGAN:
            from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

            where = AutoDateLocator(maxticks=8)
            if points[0].x == points[-1].x:
                axes.set_xlim(*(datetime.fromtimestamp(points[0].x + beside_s) for beside_s in (-3600.0, 3600.0)))
            axes.xaxis.set_major_locator(where)
            axes.xaxis.set_major_formatter(ConciseDateFormatter(where))
        return [panel]

    title = f"{metric} over {'time' if over == BEGAN else over}"
    return Picture("runs", title, draw=draw, height_in=_HEIGHT_IN)


def _at(point: Point, over: str) -> Any:
    return datetime.fromtimestamp(point.x) if over == BEGAN else point.x


def write_runs_picture(points: Sequence[Point], metric: str, over: str, path: Path) -> Path:
    """Write it (.svg or .png). Raises UnusableInputError for another format, or where it can't be written."""
    formats: dict[str, ImageFormat] = {".svg": "svg", ".png": "png"}
    form = formats.get(path.suffix.lower())
    if form is None:
        raise UnusableInputError(path, "expected a picture: .svg or .png")
    with written_whole(path) as partial:
        partial.write_bytes(draw_runs(points, metric, over).as_file(form))
    return path


Direction = Literal["rising", "falling", "level"]


@dataclass(frozen=True)
class Summary:
    """Summary of a metric over runs; `direction`: by Kendall's rank correlation with `over`, at a level of 1 %."""

    runs: int
    least: float
    median: float
    largest: float
    newest: float
    direction: Direction


def summary_of(points: Sequence[Point]) -> Summary:
    """Raises ValueError for no points."""
    if not points:
        raise ValueError("points, there are none")
    values = np.array([point.value for point in points])
    return Summary(
        len(points),
        float(values.min()),
        float(np.median(values)),
        float(values.max()),
        points[-1].value,
        _direction(np.array([point.x for point in points]), values),
    )


def _direction(x: Any, values: Any) -> Direction:
    from scipy import stats

    if len(values) < 4 or np.ptp(values) == 0.0 or np.ptp(x) == 0.0:
        return "level"
    found = stats.kendalltau(x, values)
    if found.pvalue >= 0.01:
        return "level"
    return "rising" if found.statistic > 0.0 else "falling"
