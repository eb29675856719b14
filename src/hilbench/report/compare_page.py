"""Runs side by side: their signals in one picture each, and how their metrics differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.errors import UnusableInputError
from hilbench.experiment.metrics import METRICS, working_window
from hilbench.record.recording import Recording, read_recording
from hilbench.record.result import Result
from hilbench.record.run_folder import RunFolder
from hilbench.report import plots
from hilbench.report.html import digits, number, page, section, table
from hilbench.report.reduce import mean_velocity, moving_average

Array = NDArray[np.float64]

_COLOURS: Final = (plots.BLUE, plots.VERMILLION, plots.GREEN, plots.ORANGE, plots.PURPLE, plots.SKY)
MOST_RUNS: Final = len(_COLOURS)

#: Name, title, signal (the first that a run has), axis label, factor.
_PICTURES: Final = (
    ("elasticity", "Young’s modulus, estimated", ("E_sim_Pa",), "E in N/mm²", 1e-6),
    ("tension", "Web tension", ("F_true_N", "F_sim_N"), "tension in N", 1.0),
    ("torque", "Torque of axis 2, averaged", ("tau2_Nm",), "torque in N·m", 1.0),
    ("velocity", "Velocity of axis 1 minus line speed", ("x1_m",), "v1 − line in mm/s", 1e3),
)


@dataclass(frozen=True)
class ComparedRun:
    """A run folder with what is compared of it."""

    name: str
    recording: Recording
    metrics: dict[str, float | None]
    passed: bool


@dataclass(frozen=True)
class MetricRow:
    """One metric of all runs; `differences` are to the first run, None where one of the two has no value."""

    metric: str
    unit: str
    values: list[float | None]
    differences: list[float | None]


def read_runs(paths: Sequence[Path]) -> list[ComparedRun]:
    """Read run folders. Raises UnusableInputError for one that is none, and for fewer than two or too many."""
    if not 2 <= len(paths) <= MOST_RUNS:
        raise UnusableInputError("RUN", f"{len(paths)} given, expected 2 to {MOST_RUNS} run folders")
    runs = []
    for path in paths:
        folder = RunFolder.open(path)
        result = Result.read(folder.result)
        runs.append(ComparedRun(folder.name, read_recording(folder.recording), result.metrics, result.passed))
    return runs


def metric_rows(runs: Sequence[ComparedRun]) -> list[MetricRow]:
    """The metrics that at least one run has, in the order of the first."""
    names = dict.fromkeys(name for run in runs for name in run.metrics)
    rows = []
    for name in names:
        values = [run.metrics.get(name) for run in runs]
        if any(value is not None for value in values):
            first = values[0]
            differences = [None if value is None or first is None else value - first for value in values[1:]]
            rows.append(MetricRow(name, METRICS[name].unit if name in METRICS else "", values, differences))
    return rows


def write_compare_page(runs: Sequence[ComparedRun], path: Path) -> Path:
    """Write the page; returns its path. Raises UnusableInputError if it cannot be."""
    sections = [_header(runs), _metrics(runs), section("Signals", "\n".join(_figures(runs)))]
    try:
        path.write_text(page("Comparison of runs", sections), encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(path, f"cannot be written ({error.strerror}), expected a writable folder") from error
    return path


def _header(runs: Sequence[ComparedRun]) -> str:
    names = "".join(
        f"<li>{'✓' if run.passed else '✗'} {escape(label)}: {escape(run.name)}</li>"
        for label, run in zip(labels(runs), runs, strict=True)
    )
    return f'<header>\n<h1>Comparison of runs</h1>\n<ul class="facts">{names}</ul>\n</header>'


def labels(runs: Sequence[ComparedRun]) -> list[str]:
    """Short names for pictures and columns: A, B, …"""
    return [chr(ord("A") + at) for at in range(len(runs))]


def _metrics(runs: Sequence[ComparedRun]) -> str:
    names = labels(runs)
    rows = []
    for row in metric_rows(runs):
        cells = [number(value, digits(row.unit)) for value in (*row.values, *row.differences)]
        numbers = "".join(f'<td class="number">{cell}</td>' for cell in cells)
        rows.append(f"<tr><td><code>{escape(row.metric)}</code></td>{numbers}<td>{escape(row.unit)}</td></tr>")
    columns = ("Metric", *(f">{name}" for name in names), *(f">{name} − A" for name in names[1:]), "Unit")
    return section("Metrics", table(columns, rows))


def _figures(runs: Sequence[ComparedRun]) -> list[str]:
    figures = []
    for name, title, signals, label, factor in _PICTURES:
        curves = [_curve(run.recording, signals) for run in runs]
        if any(curve is not None for curve in curves):
            svg = _picture(runs, curves, name, title, label, factor)
            figures.append(f"<figure>\n<h3>{escape(title)}</h3>\n{svg}\n</figure>")
    return figures


def _curve(recording: Recording, signals: tuple[str, ...]) -> Array | None:
    found = next((name for name in signals if name in recording), None)
    if found is None:
        return None
    values = np.asarray(recording[found], np.float64)
    width = max(round(plots.SMOOTHING_S / float(np.median(np.diff(recording.time_s)))), 1)
    if found == "tau2_Nm":
        return moving_average(values, width)
    if found != "x1_m":
        return values
    if "x2_m" not in recording:
        return None
    line = mean_velocity(recording.time_s, recording["x2_m"], width)
    return np.asarray(mean_velocity(recording.time_s, values, width) - line, np.float64)


def _picture(
    runs: Sequence[ComparedRun], curves: Sequence[Array | None], name: str, title: str, label: str, factor: float
) -> str:
    def draw(figure: Any) -> list[plots.Panel]:
        axes = figure.subplots()
        panels, shown = [], []
        for letter, run, curve, colour in zip(labels(runs), runs, curves, _COLOURS, strict=False):
            if curve is None:
                continue
            panel = plots.Panel(axes, run.recording.time_s)
            panel.line(factor * curve, letter, colour, linewidth=1.2)
            panels.append(panel)
            shown.append(factor * curve[_window(run.recording)])
        together = panels[0]
        together.names = [entry for panel in panels for entry in panel.names]
        whole = np.concatenate(shown)
        together.limits(whole, part=slice(None))
        axes.set_xlim(min(p.t_s[0] for p in panels), max(p.t_s[-1] for p in panels))
        axes.set_ylabel(label)
        axes.set_xlabel("time in s")
        return [together]

    return plots.render_picture(draw, 2.9, f"compare-{name}", title)


def _window(recording: Recording) -> slice:
    found = working_window(recording.time_s, recording["v2_cmd_m_s"]) if "v2_cmd_m_s" in recording else None
    return found or slice(0, len(recording))
