"""`hilbench sweep`: many runs of one config."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console
from typer import Option

from hilbench.apps.cli.options import ConfigArgument, JsonOption, SetOption, print_json
from hilbench.apps.cli.tables import table
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED

if TYPE_CHECKING:
    from hilbench.apps.sweep.sweep import Row, Sweep


def sweep(
    config: ConfigArgument,
    vary: Annotated[
        list[str],
        Option(
            metavar="KEY=VALUES",
            help="a list 1,2,3; 1..3:5 for five values; 1..3 for a range to sample; repeatable: all combinations",
        ),
    ],
    changes: SetOption = None,
    samples: Annotated[int | None, Option(min=1, help="points drawn from the ranges")] = None,
    seed: Annotated[int, Option(help="of the drawn points")] = 1,
    out: Annotated[Path, Option(help="folder of the sweep; the same again resumes it")] = Path("sweep"),
    jobs: Annotated[int | None, Option(min=1, help="runs at a time", show_default="all cores")] = None,
    cluster: Annotated[
        str | None, Option(metavar="ADDRESS", help="of a Dask scheduler whose workers do the runs")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Run a config over a grid or a sample of its values; one table of all metrics (OUT/results.csv and .parquet), and a
    picture of those that are judged against what was varied (OUT/results.svg).

    Every run is a process of its own, with its devices in it where that is possible (run --in-process): one that
    fails leaves its row, and the others go on. What was done is not done again when the same sweep is started once
    more. Runs on a real bus, or in real time, go one after the other.
    The workers of a cluster need this hilbench, and CONFIG and OUT under the same paths.

    Exit code: 0 all passed, or completed where nothing was judged, 1 some did not.

    Example: hilbench sweep bench_configs/web_section_step.yaml --vary controllers.tension_control.bandwidth_rad_per_s=2..10:5

    Example: hilbench sweep bench_configs/web_section_step.yaml --vary machine.web.youngs_modulus_Pa=8e9..9e9
    --vary seed=1,2,3 --samples 20

    Example: hilbench sweep bench_configs/web_section_step.yaml --vary seed=1..200:200 --cluster tcp://10.0.0.5:8786
    """  # noqa: E501
    from hilbench.apps.sweep.sweep import Sweep, parse_axis, points

    runs = points([parse_axis(text) for text in vary], samples, seed)
    made = Sweep(config, changes or (), runs, out)
    _run(made, jobs or os.cpu_count() or 1, cluster, quiet=json)
    table = made.write_table()
    made.write_parquet()
    failed = sum(row.passed is False for row in made.rows.values())
    unjudged = sum(row.passed is None for row in made.rows.values())
    if json:
        print_json({"table": str(table), "runs": made.as_data()})
    else:
        _show(made)
        completed = f", {unjudged} completed, nothing judged" if unjudged else ""
        drawn = _draw(made)
        beside = f", {drawn}" if drawn is not None else ""
        print(f"{len(made.rows)} runs, {failed} not passed{completed}: {table}{beside}")
    raise typer.Exit(EXIT_CRITERION_FAILED if failed else EXIT_PASSED)


_MOST_ROWS = 50


def _show(made: Sweep) -> None:
    """The table: what was varied, the verdict and the metrics that are judged."""
    metrics, rows = made.shown_metrics(), made.sorted_rows()
    lines = []
    for row in rows[:_MOST_ROWS]:
        verdict = {True: "passed", None: "completed"}.get(row.passed, f"exit code {row.exit_code}")
        figures = [row.metrics.get(name) for name in metrics]
        varied = [row.changes.get(name, "") for name in made.varied]
        lines.append((str(row.number), *varied, verdict, *("-" if each is None else f"{each:.4g}" for each in figures)))
    columns = (">run", *(f">{name}" for name in made.varied), "", *(f">{name}" for name in metrics))
    Console(highlight=False).print(table(columns, lines))
    if len(rows) > _MOST_ROWS:
        print(f"the first {_MOST_ROWS} of {len(rows)} runs")


def _draw(made: Sweep) -> Path | None:
    """Write the picture (SVG) of the judged metrics against the numbers that were varied; runs that did not pass are
    marked. None where there is nothing to draw. Raises UnusableInputError if it can't be written."""
    rows = made.sorted_rows()
    varied = {name: [_number(row.changes.get(name, "")) for row in rows] for name in made.varied}
    metrics = {name: [row.metrics.get(name) for row in rows] for name in made.shown_metrics()}
    across = [name for name, values in varied.items() if len({*values} - {None}) > 1][:_MOST_VARIED]
    down = [name for name, values in metrics.items() if {*values} != {None}][:_MOST_METRICS]
    if not across or not down:
        return None
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    from hilbench.files import written_whole

    passed, path = [row.passed for row in rows], made.out / "results.svg"
    style: Any = {**dict(matplotlib.rcParamsDefault), "font.size": 8.0, "svg.hashsalt": "hilbench-sweep"}
    with matplotlib.rc_context(style), written_whole(path) as partial:
        figure = Figure(figsize=(_PANEL_IN[0] * len(across), _PANEL_IN[1] * len(down)), layout="constrained")
        FigureCanvasSVG(figure)
        panels = figure.subplots(len(down), len(across), squeeze=False, sharex="col", sharey="row")
        for row, metric in enumerate(down):
            for column, name in enumerate(across):
                _draw_panel(panels[row][column], varied[name], metrics[metric], passed)
            panels[row][0].set_ylabel(metric)
        for column, name in enumerate(across):
            panels[-1][column].set_xlabel(name)
        figure.savefig(partial, format="svg", metadata={"Date": None})
    return path


def _number(text: str) -> float | None:
    from math import isfinite

    try:
        value = float(text)
    except ValueError:
        return None
    return value if isfinite(value) else None


def _run(made: Sweep, jobs: int, cluster: str | None, *, quiet: bool) -> None:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    hidden = quiet or not console.is_terminal
    # Without a thread of its own: beside one a process is not copied.
    with Progress(*columns, console=console, disable=hidden, auto_refresh=False) as progress:
        task = progress.add_task("runs", total=len(made.runs), completed=len(made.rows))

        def done(row: Row) -> None:
            progress.advance(task)
            progress.refresh()
            if not quiet:
                done = "passed" if row.passed else "completed, nothing judged"
                word = done if row.passed is not False else f"exit code {row.exit_code} {row.said}".strip()
                varied = ", ".join(f"{path}={value}" for path, value in row.changes.items())
                progress.console.print(f"{row.number}: {varied}: {word}", soft_wrap=True)

        made.run(jobs, done, cluster)


Values = Sequence[float | None]

#: Panels beside and above each other, at most: beyond, nobody reads them.
_MOST_VARIED, _MOST_METRICS = 4, 6
_PANEL_IN: Final = (3.2, 2.2)


def _draw_panel(axes: Any, x: Values, y: Values, passed: Sequence[bool | None]) -> None:
    from hilbench.apps.report.chart import BLUE, VERMILLION

    for failed, colour, marker in ((False, BLUE, "o"), (True, VERMILLION, "x")):
        points = [
            (one, other)
            for one, other, verdict in zip(x, y, passed, strict=True)
            if one is not None and other is not None and (verdict is False) is failed
        ]
        if points:
            axes.plot(*zip(*points, strict=True), linestyle="", marker=marker, markersize=4.0, color=colour)
    axes.grid(visible=True, linewidth=0.4, alpha=0.5)
