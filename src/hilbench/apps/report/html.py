"""`report.html`: one self-contained page of a run, for the screen and for paper."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain, count, groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.apps.report.chart import GREEN, INK, VERMILLION, Mark
from hilbench.apps.report.page import number, quantity, write_page
from hilbench.apps.report.panel import recorded_panels
from hilbench.apps.report.plots import DrawnAxes, ImageFormat, Picture, draw_histogram, run_pictures, zooms
from hilbench.apps.report.web_line_drawing import line_picture
from hilbench.arrays import Array
from hilbench.files import make_folder, usable, written_whole
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import find_effect
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import EventRecord, FoundRecord, GapHistory, Result, StepRecord, Timing
from hilbench.results.run_folder import RunFolder
from hilbench.runs.events import find_events
from hilbench.runs.metrics import OF_RUNS, all_metrics, find_metric, kind_of_figures, of_steps

_TITLE: Final = "Gap between measurement and model"
_CAPTION: Final = (
    "How far the measured torque is from what the model in the twin says, without what is noise: red while an effect "
    "that the model lacks is there, green while there is none or the model has it. Dashed: the same of the model as it "
    "was configured."
)
#: Heights in the picture, as shares: up to which lines go, of the arrow between two of them, and of the words above.
_LINES, _ARROW, _BECAME, _WHAT = 0.77, 0.73, 0.79, 0.87
#: Steps side by side in a table, and those in the list of them.
_MOST_COLUMNS = 8
_MOST_ROWS = 100


def estimated_rows(result: Result) -> list[tuple[str, ...]]:
    """A row for each parameter that the data show."""
    return [
        (
            each.effect.replace("_", " "),
            each.place,
            each.parameter,
            f"{each.value:.3g}",
            f"{each.ci95[0]:.3g} to {each.ci95[1]:.3g}",
            each.unit,
            ", ".join(each.tied_with).replace("_", " "),
        )
        for each in result.estimated or []
        if each.separable
    ]


def found_pictures(result: Result) -> list[Picture]:
    """The picture, where something looked for effects while the bench ran."""
    if result.gap_history is None or not result.gap_history.t_s:
        return []
    history, found = result.gap_history, result.found or []
    return [Picture("found", _TITLE, _CAPTION, draw=lambda figure: _draw(figure, history, found), height_in=3.4)]


def _row(found: FoundRecord) -> Iterator[str]:
    yield number(found.t_s, 6)
    yield ("no longer " if found.gone else "") + found.effect.replace("_", " ")
    yield found.part
    yield ", ".join(
        f"{name} {each.value:.4g}" + (f" ({each.ci95[0]:.4g} to {each.ci95[1]:.4g})" if not found.gone else "")
        for name, each in found.parameters.items()
    )
    yield number(found.named_after_s)
    never = "refused" if found.refused else "–"
    yield number(found.applied_after_s) if found.applied_after_s is not None else never
    yield "" if found.gap is None else f"{found.gap.before:.3g} → {found.gap.after:.3g}"
    yield ", ".join(found.tied_with).replace("_", " ")


def _draw(figure: Any, history: GapHistory, found: Sequence[FoundRecord]) -> list[DrawnAxes]:
    axes = figure.subplots()
    t_s, in_use, configured = (
        np.array(values, np.float64) for values in (history.t_s, history.in_use, history.configured)
    )
    parts = _parts(t_s, found)
    axes.fill_between(t_s, 0.0, in_use, where=~parts, color=GREEN, alpha=0.55, linewidth=0, step="pre")
    axes.fill_between(t_s, 0.0, in_use, where=parts, color=VERMILLION, alpha=0.55, linewidth=0, step="pre")
    axes.step(t_s, configured, color=INK, linewidth=1.0, linestyle=(0, (3, 2)), alpha=0.7, where="pre")
    axes.set_ylim(0.0, 1.45 * float(np.nanmax([*in_use, *configured, 1e-9])))
    axes.set_xlim(t_s[0], t_s[-1])
    axes.set_xlabel("time in s")
    axes.set_ylabel(f"gap of {history.signal} in {history.unit}")
    for begun_s, together in groupby(found, key=lambda each: each.t_s):
        _mark(axes, begun_s, list(together))
    return [DrawnAxes(axes)]


def _mark(axes: Any, t_s: float, found: Sequence[FoundRecord]) -> None:
    """Mark when an effect came, and when the model had it, joined by an arrow; above them its name."""
    top = axes.get_ylim()[1]
    axes.axvline(t_s, ymax=_LINES, color=VERMILLION, linewidth=1.0)
    after_s = found[0].applied_after_s
    if after_s is not None:
        axes.axvline(t_s + after_s, ymax=_LINES, color=GREEN, linewidth=1.0)
        style = {"arrowstyle": "->", "color": INK, "linewidth": 0.8}
        axes.annotate("", (t_s + after_s, _ARROW * top), (t_s, _ARROW * top), arrowprops=style)
        words = "out of the model" if found[0].gone else "in the model"
        axes.text(t_s + after_s, _BECAME * top, words, va="bottom", ha="right", fontsize=8, color=GREEN)
    axes.text(t_s, _WHAT * top, "\n".join(map(_words, found)), va="bottom", ha="left", fontsize=8)


def _words(found: FoundRecord) -> str:
    where = f", {found.part}" if found.part else ""
    size = "" if found.gone else f": {_size(found)}"
    return f"{'no ' if found.gone else ''}{found.effect.replace('_', ' ')}{where}{size}"


def _size(found: FoundRecord) -> str:
    """Its strength, in a unit that is read easily."""
    each = next(iter(found.parameters.values()))
    for kind in MachineKind:
        with suppress(KeyError):
            each = found.parameters[find_effect(found.effect, kind).strength[0]]
    if each.unit == "m":
        return f"{1e6 * each.value:.3g} µm"
    return f"{each.value:.3g} {'' if each.unit == '1' else each.unit}".strip()


def _parts(t_s: Array, found: Sequence[FoundRecord]) -> NDArray[np.bool_]:
    """(n,): from when something came until the model had it."""
    parts = np.zeros(len(t_s), bool)
    for each in found:
        until_s = np.inf if each.applied_after_s is None else each.t_s + each.applied_after_s
        parts |= (t_s > each.t_s) & (t_s <= until_s)
    return parts


def write_report(run_folder: RunFolder) -> Path:
    """Write the report of a run from its config.yaml, result.json and recording.mf4; returns its path.

    The same files give the same report. Raises UnusableInputError if one of them is missing or not readable,
    or the report cannot be written.
    """
    recording, result = read_recording(run_folder.recording), Result.read(run_folder.result)
    with usable(run_folder.config, "read", "the run's config"):
        config = run_folder.config.read_text(encoding="utf-8")
    marks = marks_of(result, recording)
    pictures = _pictures(run_folder, recording, result, marks)
    steps, timing = result.steps or [], result.timing
    return write_page(
        run_folder.report,
        "report/report",
        pictures["run"],
        marks,
        name=run_folder.name,
        result=result,
        facts=_facts(result, recording),
        summary=_summary(result),
        faults=[(number(fault.time_s, 6), fault.source, fault.text) for fault in result.faults],
        pictures=pictures,
        found=[tuple(_row(each)) for each in result.found or []],
        estimated=estimated_rows(result),
        warnings=_warnings(result),
        reasons_of=_reasons,
        step_columns=(
            "Metric",
            *(f">step {step.number}" if step.number else ">working window" for step in steps[:_MOST_COLUMNS]),
            "Unit",
        ),
        step_metrics=[
            (name, known.unit)
            for name in {**all_metrics(), **result.metrics}
            if any(name in step.figures for step in steps) and (known := find_metric(name))
        ],
        most_columns=_MOST_COLUMNS,
        most_rows=_MOST_ROWS,
        metrics=_metrics(result),
        timing=_timing(timing),
        config=config,
    )


def _pictures(
    run_folder: RunFolder, recording: Recording, result: Result, marks: Sequence[Mark]
) -> dict[str, list[Picture]]:
    """Pictures of what was read from a run folder, by their section of the report."""
    run = run_pictures(recording, marks, recorded_panels(recording).reference(run_folder.config, recording))
    histogram = result.timing.jitter_histogram
    return {
        "line": line_picture(run_folder.config, recording),
        "found": found_pictures(result),
        "run": run,
        "zooms": zooms(run, marks),
        "timing": [draw_histogram(histogram)] if histogram else [],
    }


def write_pictures(run_folder: RunFolder, into: Path, form: ImageFormat) -> list[Path]:
    """Write each picture of a run's report as a file of its own into the folder `into`, which is made.

    Returns their paths. Raises UnusableInputError for what is missing in the run folder, or can't be written.
    """
    recording, result = read_recording(run_folder.recording), Result.read(run_folder.result)
    make_folder(into)
    written = []
    for picture in chain(*_pictures(run_folder, recording, result, marks_of(result, recording)).values()):
        if picture.draw is not None:
            written.append(into / f"{picture.name}.{form}")
            with written_whole(written[-1]) as partial:
                partial.write_bytes(picture.as_file(form))
    return written


def marks_of(result: Result | None, recording: Recording) -> list[Mark]:
    """Marks in the pictures: by the result, or, of an older run, by the signals."""
    events = result.events if result is not None and result.events is not None else None
    if events is None:
        events = [EventRecord.of(event) for event in find_events(recording.channels)]
    numbers = count(1)
    return [
        Mark(event.start_s, event.end_s, event.text, str(next(numbers)) if event.kind == "step" else "")
        for event in events
    ]


def _facts(result: Result, recording: Recording) -> list[str]:
    """Facts of the run, in short."""
    duration_s = recording.time_s[-1] - recording.time_s[0]
    facts = [f"{duration_s:.1f} s of bus time", f"{recording.samples} cycles of {result.timing.cycle_us / 1000:g} ms"]
    facts.append(f"pace {result.timing.pace}")
    if recording.start_time is not None:
        facts.insert(0, f"{recording.start_time:%Y-%m-%d %H:%M:%S} UTC")
    if result.environment is not None and result.environment.seed is not None:
        facts.append(f"seed {result.environment.seed}")
    return facts


def _summary(result: Result) -> str:
    failed = sum(not criterion.passed for criterion in result.criteria)
    parts = [{"passed": "Passed", "completed": "Completed, nothing judged"}.get(result.verdict, "Failed")]
    if result.criteria:
        parts.append(f"{len(result.criteria) - failed} of {len(result.criteria)} criteria met")
    marginal = sum(criterion.marginal for criterion in result.criteria)
    if marginal:
        parts.append(f"{marginal} of them marginally")
    if result.faults:
        parts.append(f"{len(result.faults)} fault{'s' if len(result.faults) > 1 else ''}")
    return ", ".join(parts)


def _warnings(result: Result) -> list[tuple[str, ...]]:
    """Warnings about the timing of the whole run, then each kind of warning with its count."""
    rows: list[tuple[str, ...]] = [("", "", text, "", "") for text in result.timing.warnings()]
    for warning in result.warnings or []:
        last = "" if warning.last_text in (None, warning.text) else f"; the last: {warning.last_text}"
        times = number(warning.count, 12), number(warning.last_time_s, 6)
        rows.append((number(warning.time_s, 6), warning.source, warning.text + last, *times))
    return rows


def _reasons(step: StepRecord) -> list[tuple[str, list[str]]]:
    """Each reason why something was not judged once, with the metrics it is of."""
    metrics: dict[str, list[str]] = {}
    for metric, reason in step.reasons.items():
        metrics.setdefault(reason, []).append(metric)
    return list(metrics.items())


def _metrics(result: Result) -> list[tuple[str, ...]]:
    """Name, value, unit, and what it means or why it has no value."""
    rows: list[tuple[str, ...]] = []
    metrics = {**of_steps()[kind_of_figures(result.metrics)].metrics, **OF_RUNS}
    for name, value in result.metrics.items():
        known = metrics.get(name) or find_metric(name)
        unit = known.unit if known else ""
        why = (result.not_judged or {}).get(name) if value is None else None
        meaning = [text for text in (known.description if known else None, why) if text]
        rows.append((name, quantity(value, unit), unit, "; ".join(meaning)))
    return rows


def _timing(timing: Timing) -> list[tuple[str, str, str]]:
    rows = [
        ("pace", timing.pace, ""),
        ("cycle", number(timing.cycle_us), "µs"),
        ("cycles", number(timing.cycles, 12), ""),
        ("cycles missed", number(timing.missed, 12), ""),
        *([("cycles with late set points", number(timing.late_set_points, 12), "")] if timing.late_set_points else []),
        ("bus time over wall time", number(timing.realtime_factor), ""),
        ("bus load, mean", number(timing.bus_load_pct), "%"),
        ("frames lost by the bench", _count(timing.lost_frames), ""),
        *((f"frames lost by the {name}", _count(lost), "") for name, lost in (timing.lost_frames_of or {}).items()),
        *(
            (f"late samples of {name}, up to {late.oldest_cycles} cycle(s) old", number(late.share_pct), "%")
            for name, late in (timing.late or {}).items()
        ),
    ]
    if timing.jitter_us is not None:
        late = timing.jitter_us
        for label, value in (("median", late.p50), ("99 %", late.p99), ("99.9 %", late.p999), ("largest", late.max)):
            rows.append((f"lateness of SYNC, {label}", number(value), "µs"))
    return rows


def _count(value: int | None) -> str:
    return "not known" if value is None else number(value, 12)
