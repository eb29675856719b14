"""Runs side by side: their signals in one picture each, and how their metrics differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hilbench.apps.report.chart import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION, Chart, Curve
from hilbench.apps.report.page import quantity, write_page
from hilbench.apps.report.panel import ShownRun, recorded_panels
from hilbench.apps.report.plots import Picture, drawn
from hilbench.errors import UnusableInputError
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.runs.criteria import RunVerdict
from hilbench.runs.events import find_events
from hilbench.runs.metrics import find_metric

_COLOURS: Final = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
MOST_RUNS: Final = len(_COLOURS)


@dataclass(frozen=True)
class ComparedRun:
    """A run folder with what is compared of it."""

    name: str
    shown: ShownRun
    metrics: dict[str, float | None]
    verdict: RunVerdict


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
    return [_read(RunFolder.open(path)) for path in paths]


def _read(folder: RunFolder) -> ComparedRun:
    result, recording = Result.read(folder.result), read_recording(folder.recording)
    times_s = [(event.start_s, event.end_s) for event in find_events(recording.channels)]
    return ComparedRun(folder.name, ShownRun.of(recording, times_s), result.metrics, result.verdict)


def metric_rows(runs: Sequence[ComparedRun]) -> list[MetricRow]:
    """The metrics that at least one run has, in the order of the first."""
    names = dict.fromkeys(name for run in runs for name in run.metrics)
    rows = []
    for name in names:
        values = [run.metrics.get(name) for run in runs]
        if any(value is not None for value in values):
            first = values[0]
            differences = [None if value is None or first is None else value - first for value in values[1:]]
            rows.append(MetricRow(name, known.unit if (known := find_metric(name)) else "", values, differences))
    return rows


def write_compare_page(runs: Sequence[ComparedRun], path: Path) -> Path:
    """Write the page; returns its path. Raises UnusableInputError if it cannot be."""
    names, pictures = labels(runs), _pictures(runs)
    rows = [
        (row.metric, *(quantity(value, row.unit) for value in (*row.values, *row.differences)), row.unit)
        for row in metric_rows(runs)
    ]
    columns = ("Metric", *(f">{name}" for name in names), *(f">{name} − A" for name in names[1:]), "Unit")
    labelled = list(zip(names, runs, strict=True))
    return write_page(path, "compare/compare", pictures, runs=labelled, columns=columns, rows=rows, pictures=pictures)


def labels(runs: Sequence[ComparedRun]) -> list[str]:
    """Short names for pictures and columns: A, B, …"""
    return [chr(ord("A") + at) for at in range(len(runs))]


def _pictures(runs: Sequence[ComparedRun]) -> list[Picture]:
    """Pictures by which runs are compared, those of the first run's machine."""
    pictures = []
    for panel in recorded_panels(runs[0].shown.recording).panels:
        compared, found = panel.compared, list[Curve]()
        for letter, run, colour in zip(labels(runs), runs, _COLOURS, strict=False):
            if compared is not None and (values := compared.of(run.shown)) is not None:
                found.append(Curve(letter, run.shown.t_s, values / panel.si_per_unit, colour, 1.2))
        if compared is not None and found:
            picture = Picture(f"compare-{panel.name}", compared.title, charts=[Chart(panel.label, found)])
            pictures.append(drawn(picture))
    return pictures
