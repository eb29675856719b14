"""The picture of a sweep: each metric against each value that was varied, a point a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hilbench.apps.report.chart import BLUE, VERMILLION
from hilbench.files import written_whole

Values = Sequence[float | None]

#: Panels beside and above each other, at most: beyond, nobody reads them.
_MOST_VARIED, _MOST_METRICS = 4, 6
_PANEL_IN: Final = (3.2, 2.2)


def write_sweep_picture(
    varied: Mapping[str, Values], metrics: Mapping[str, Values], passed: Sequence[bool | None], path: Path
) -> Path | None:
    """Write the picture (SVG) of `varied` and `metrics`, each a number a run; runs that did not pass are marked.

    None where there is nothing to draw. Raises UnusableInputError if it can't be written.
    """
    across, down = list(varied)[:_MOST_VARIED], list(metrics)[:_MOST_METRICS]
    if not across or not down:
        return None
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    style: Any = {**dict(matplotlib.rcParamsDefault), "font.size": 8.0, "svg.hashsalt": "hilbench-sweep"}
    with matplotlib.rc_context(style), written_whole(path) as partial:
        figure = Figure(figsize=(_PANEL_IN[0] * len(across), _PANEL_IN[1] * len(down)), layout="constrained")
        FigureCanvasSVG(figure)
        panels = figure.subplots(len(down), len(across), squeeze=False, sharex="col", sharey="row")
        for row, metric in enumerate(down):
            for column, name in enumerate(across):
                _draw(panels[row][column], varied[name], metrics[metric], passed)
            panels[row][0].set_ylabel(metric)
        for column, name in enumerate(across):
            panels[-1][column].set_xlabel(name)
        figure.savefig(partial, format="svg", metadata={"Date": None})
    return path


def _draw(axes: Any, x: Values, y: Values, passed: Sequence[bool | None]) -> None:
    for failed, colour, marker in ((False, BLUE, "o"), (True, VERMILLION, "x")):
        points = [
            (one, other)
            for one, other, verdict in zip(x, y, passed, strict=True)
            if one is not None and other is not None and (verdict is False) is failed
        ]
        if points:
            axes.plot(*zip(*points, strict=True), linestyle="", marker=marker, markersize=4.0, color=colour)
    axes.grid(visible=True, linewidth=0.4, alpha=0.5)
