"""`report.html`: one self-contained page of a run, for the screen and for paper.

Nothing in it is loaded from elsewhere; whatever comes from a file is escaped, and the page's policy lets no other
script run than those that make its pictures interactive.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.synchronization import reference_estimate
from hilbench.errors import UnusableInputError
from hilbench.report.chart import Mark
from hilbench.report.live import interactive, policy, style
from hilbench.report.plots import Picture, draw_histogram, run_pictures, zooms
from hilbench.results.provenance import Provenance
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Environment, EventRecord, Fault, Result, StepRecord, Timing
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load_with_overrides
from hilbench.runs.criteria import CriterionResult
from hilbench.runs.events import find_events
from hilbench.runs.metrics import METRICS

_DASH = "–"
#: Steps that stand side by side in a table, and those in the list of them.
_MOST_COLUMNS = 8
_MOST_ROWS = 100
_BLANK = "<td></td>"


def write_report(run_folder: RunFolder) -> Path:
    """Write the report of a run from its config.yaml, result.json and recording.mf4; returns its path.

    The same files give the same report. Raises UnusableInputError if one of them is missing or not readable,
    or the report cannot be written.
    """
    recording = read_recording(run_folder.recording)
    text = render(
        run_folder.name,
        _read_text(run_folder.config),
        Result.read(run_folder.result),
        recording,
        _reference(run_folder.config, recording),
    )
    partial = run_folder.report.with_name(f".{run_folder.report.name}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(run_folder.report)
    except OSError as error:
        raise UnusableInputError(
            run_folder.report, f"cannot be written ({error.strerror}), expected a writable folder"
        ) from error
    return run_folder.report


def _reference(config: Path, recording: Recording) -> NDArray[np.float64] | None:
    """E by the published method; None also for the config of a run that is too old to be understood now."""
    try:
        return reference_estimate(load_with_overrides(config).config, recording)
    except UnusableInputError:
        return None


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UnusableInputError(path, f"cannot be read ({reason}), expected the run's config") from error


def render(
    name: str, config: str, result: Result, recording: Recording, reference_Pa: NDArray[np.float64] | None = None
) -> str:
    """The page as text. `name` is the run's, `config` the text of its config file, `reference_Pa` as in the plots."""
    marks = marks_of(result, recording)
    pictures = run_pictures(recording, marks, reference_Pa)
    sections = (
        _header(name, result, recording),
        _criteria(result.criteria),
        _faults(result.faults),
        _pictures(pictures, zooms(pictures, marks)),
        _warnings(result),
        _steps(result.steps or []),
        _metrics(result),
        _timing(result.timing),
        _provenance(result.provenance),
        _environment(result.environment),
        section("Config", f"<pre>{escape(config)}</pre>"),
        interactive(pictures, marks),
    )
    return page(f"{name}: {_verdict_word(result)}", sections)


def marks_of(result: Result | None, recording: Recording) -> list[Mark]:
    """What is marked in the pictures: what the result says, or, of an older run, what the signals show."""
    events = result.events if result is not None and result.events is not None else None
    if events is None:
        events = [EventRecord.of(event) for event in find_events(recording.channels)]
    numbers = itertools.count(1)
    return [
        Mark(event.start_s, event.end_s, event.text, str(next(numbers)) if event.kind == "step" else "")
        for event in events
    ]


def page(title: str, sections: Iterable[str]) -> str:
    """A whole page with the reports' style sheet; `title` is escaped here, the sections are markup."""
    own = resources.files("hilbench.report").joinpath("page.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy()}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style()}\n{own}</style>\n</head>\n<body>\n"
        + "\n".join(filter(None, sections))
        + "\n</body>\n</html>\n"
    )


def _verdict_word(result: Result) -> str:
    return "passed" if result.passed else "failed"


def _header(name: str, result: Result, recording: Recording) -> str:
    duration_s = recording.time_s[-1] - recording.time_s[0]
    facts = [f"{duration_s:.1f} s of bus time", f"{len(recording)} cycles of {result.timing.cycle_us / 1000:g} ms"]
    facts.append(f"pace {result.timing.pace}")
    if recording.start_time is not None:
        facts.insert(0, f"{recording.start_time:%Y-%m-%d %H:%M:%S} UTC")
    if result.environment is not None and result.environment.seed is not None:
        facts.append(f"seed {result.environment.seed}")
    return (
        f"<header>\n<h1>{escape(name)}</h1>\n"
        f'<p class="facts">{escape(" · ".join(facts))}</p>\n'
        f'<p class="verdict {_verdict_word(result)}">{_mark(result.passed)} {_summary(result)}</p>'
        f"{_warned(result)}\n</header>"
    )


def _summary(result: Result) -> str:
    failed = sum(not criterion.passed for criterion in result.criteria)
    parts = [_verdict_word(result).capitalize()]
    if result.criteria:
        parts.append(f"{len(result.criteria) - failed} of {len(result.criteria)} criteria met")
    marginal = sum(criterion.marginal for criterion in result.criteria)
    if marginal:
        parts.append(f"{marginal} of them marginally")
    if result.faults:
        parts.append(f"{len(result.faults)} fault{'s' if len(result.faults) > 1 else ''}")
    return ", ".join(parts)


def _warned(result: Result) -> str:
    """How many warnings there are, and where."""
    count = len(result.all_warnings())
    return f' <a class="warned" href="#warnings">{count} warning{"s" if count > 1 else ""}</a>' if count else ""


def _mark(passed: bool) -> str:
    return "✓" if passed else "✗"


def _criteria(criteria: Sequence[CriterionResult]) -> str:
    if not criteria:
        return section("Criteria", '<p class="note">The config sets none.</p>')
    rows = []
    for criterion in criteria:
        word = criterion.verdict
        value = number(criterion.value, digits(criterion.unit))
        rows.append(
            f'<tr><td>{escape(criterion.name)}</td><td class="number">{value}</td>'
            f'<td class="number">{escape(criterion.limit)}</td><td>{escape(criterion.unit)}</td>'
            f'<td class="result {word}">{_mark(criterion.passed)} {word}{_why(criterion)}</td></tr>'
        )
    return section("Criteria", table(("Criterion", ">Value", ">Limit", "Unit", "Result"), rows))


def _why(criterion: CriterionResult) -> str:
    """Beside the verdict: which step it is of, and what is to be said of it."""
    told = [f"step {criterion.step}"] if criterion.step and criterion.value is not None else []
    told += [criterion.reason] if criterion.reason else []
    return f'<span class="reason">{escape("; ".join(told))}</span>' if told else ""


def _faults(faults: Sequence[Fault]) -> str:
    if not faults:
        return ""
    rows = [
        f'<tr><td class="number">{number(fault.time_s, 6)}</td><td>{escape(fault.source)}</td>'
        f"<td>{escape(fault.text)}</td></tr>"
        for fault in faults
    ]
    return section("Faults", table((">Time in s", "Where", "What"), rows))


def _warnings(result: Result) -> str:
    """What the timing says of the whole run, then each kind of warning with its count."""
    rows = [f"<tr>{_BLANK}{_BLANK}<td>{escape(text)}</td>{_BLANK}{_BLANK}</tr>" for text in result.timing.warnings()]
    for warning in result.warnings or []:
        last = "" if warning.last_text in (None, warning.text) else f"; the last: {warning.last_text}"
        rows.append(
            f'<tr><td class="number">{number(warning.time_s, 6)}</td><td>{escape(warning.source)}</td>'
            f'<td>{escape(warning.text + last)}</td><td class="number">{number(warning.count, 12)}</td>'
            f'<td class="number">{number(warning.last_time_s, 6)}</td></tr>'
        )
    columns = (">Time in s", "Where", "What", ">Times", ">Last at, s")
    return f'<section id="warnings">\n<h2>Warnings</h2>\n{table(columns, rows)}\n</section>' if rows else ""


def _pictures(pictures: Sequence[Picture], around_steps: Sequence[Picture]) -> str:
    figures = "\n".join(map(figure, [*pictures, *around_steps]))
    return section("What happened", f'<div class="zooms" hidden></div>\n{figures}')


def figure(picture: Picture) -> str:
    """A picture as it is drawn; `hilbench.report.live` makes it interactive."""
    drawn = picture.svg or '<p class="note">Not drawn: the recording lacks these signals.</p>'
    caption = f"<figcaption>{escape(picture.caption)}</figcaption>" if picture.svg and picture.caption else ""
    return (
        f'<figure data-picture="{escape(picture.name)}">\n<h3>{escape(picture.title)}</h3>\n'
        f'<div class="drawn">{drawn}</div>\n{caption}\n</figure>'
    )


def _steps(steps: Sequence[StepRecord]) -> str:
    """Each step with its figures; what could not be judged with its reason."""
    if not steps:
        return ""
    metrics = [name for name in METRICS if any(name in step.figures for step in steps)]
    columns = ("Metric", *(f">{_step_name(step)}" for step in steps[:_MOST_COLUMNS]), "Unit")
    rows, notes = [], []
    for name in metrics:
        unit = METRICS[name].unit
        cells = "".join(_step_figure(step, name, digits(unit)) for step in steps[:_MOST_COLUMNS])
        rows.append(f"<tr><td><code>{escape(name)}</code></td>{cells}<td>{escape(unit)}</td></tr>")
    heads = "".join(
        f'<tr><td class="number">{step.number or ""}</td><td>{escape(step.text)}</td>'
        f'<td class="number">{number(step.time_s, 6)}</td><td class="number">{number(step.until_s, 6)}</td>'
        f"<td>{_reasons(step)}</td></tr>"
        for step in steps[:_MOST_ROWS]
    )
    if len(steps) > _MOST_COLUMNS:
        notes.append(
            f'<p class="note">Figures of the first {_MOST_COLUMNS} of {len(steps)} steps; '
            "result.json has those of all.</p>"
        )
    which = table((">Step", "What", ">From, s", ">To, s", "Not judged"), [heads])
    return section("Steps", which + "<h3>Figures of each step</h3>" + table(columns, rows) + "".join(notes))


def _step_name(step: StepRecord) -> str:
    return f"step {step.number}" if step.number else "working window"


def _step_figure(step: StepRecord, metric: str, significant: int) -> str:
    reason = step.reasons.get(metric)
    title = f' title="{escape(reason)}"' if reason else ""
    text = number(step.figures.get(metric), significant) if metric in step.figures else ""
    return f'<td class="number"{title}>{text}</td>'


def _reasons(step: StepRecord) -> str:
    """Each reason once, with the metrics it is of."""
    metrics: dict[str, list[str]] = {}
    for metric, reason in step.reasons.items():
        metrics.setdefault(reason, []).append(metric)
    return "".join(
        f'<span class="note">{escape(", ".join(names))}: {escape(reason)}</span><br>'
        for reason, names in metrics.items()
    ).removesuffix("<br>")


def _metrics(result: Result) -> str:
    rows = []
    for name, value in result.metrics.items():
        known = METRICS.get(name)
        unit = known.unit if known else ""
        why = (result.not_judged or {}).get(name) if value is None else None
        meaning = f"{known.description if known else ''}{'; ' if why else ''}{why or ''}"
        rows.append(
            f"<tr><td><code>{escape(name)}</code></td>"
            f'<td class="number">{number(value, digits(unit))}</td><td>{escape(unit)}</td>'
            f'<td class="note">{escape(meaning)}</td></tr>'
        )
    note = '<p class="note">Of several steps the worst.</p>' if result.steps and len(result.steps) > 1 else ""
    return section("Metrics", table(("Metric", ">Value", "Unit", "Meaning"), rows) + note) if rows else ""


def _timing(timing: Timing) -> str:
    rows = [
        ("pace", timing.pace, ""),
        ("cycle", number(timing.cycle_us), "µs"),
        ("cycles", number(timing.cycles, 12), ""),
        ("cycles missed", number(timing.missed, 12), ""),
        ("bus time over wall time", number(timing.realtime_factor), ""),
        ("bus load, mean", number(timing.bus_load_pct), "%"),
        ("frames lost by the bench", _count(timing.lost_frames), ""),
        *(
            (f"frames lost by the {escape(name)}", _count(lost), "")
            for name, lost in (timing.lost_frames_of or {}).items()
        ),
        *(
            (f"late samples of {escape(name)}, up to {late.oldest_cycles} cycle(s) old", number(late.share_pct), "%")
            for name, late in (timing.late or {}).items()
        ),
    ]
    if timing.jitter_us is not None:
        late = timing.jitter_us
        for label, value in (("median", late.p50), ("99 %", late.p99), ("99.9 %", late.p999), ("largest", late.max)):
            rows.append((f"lateness of SYNC, {label}", number(value), "µs"))
    lines = [
        f'<tr><td>{name}</td><td class="number">{escape(value)}</td><td>{unit}</td></tr>' for name, value, unit in rows
    ]
    figures = table(("Quantity", ">Value", "Unit"), lines)
    histogram = figure(draw_histogram(timing.jitter_histogram)) if timing.jitter_histogram else ""
    return section("Timing", figures + histogram)


def _provenance(provenance: Provenance | None) -> str:
    if provenance is None:
        return ""
    commit = provenance.git
    rows = [
        ("config", provenance.config),
        ("git commit", "none" if commit is None else commit.commit + (", with changes" if commit.changed else "")),
        ("host", provenance.host),
        ("simulated hardware and twin", provenance.participants),
        *((f"{each.key}, by {each.option}", str(each.value)) for each in provenance.overridden),
    ]
    rows += [(f"EDS of {', '.join(each.nodes)}", f"{each.file} sha256 {each.sha256}") for each in provenance.eds]
    lines = [f'<tr><td>{escape(what)}</td><td class="long">{escape(value)}</td></tr>' for what, value in rows]
    return section("Where it comes from", table(("What", "Value"), lines))


def _environment(environment: Environment | None) -> str:
    if environment is None:
        return section("Versions", '<p class="note">Not recorded.</p>')
    versions = {"hilbench": environment.hilbench, "Python": environment.python, "system": environment.platform}
    rows = [
        f"<tr><td>{escape(name)}</td><td>{escape(version)}</td></tr>"
        for name, version in (versions | environment.libraries).items()
    ]
    seed = "none" if environment.seed is None else str(environment.seed)
    return section("Versions", table(("What", "Version"), [*rows, f"<tr><td>seed</td><td>{seed}</td></tr>"]))


def section(title: str, body: str) -> str:
    """A titled section of markup."""
    return f"<section>\n<h2>{title}</h2>\n{body}\n</section>"


def table(columns: Sequence[str], rows: Iterable[str]) -> str:
    """A table; a column whose title begins with ">" is set flush right, as its numbers are."""
    head = "".join(
        f'<th scope="col" class="number">{title[1:]}</th>' if title[0] == ">" else f'<th scope="col">{title}</th>'
        for title in columns
    )
    return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody>\n</table>"


def _count(value: int | None) -> str:
    return "not known" if value is None else number(value, 12)


def digits(unit: str) -> int:
    """Significant digits for a unit: what matters of a web's velocity begins at the fifth."""
    return 7 if unit == "m/s" else 4


def number(value: float | None, significant: int = 4) -> str:
    """A number for the eye: `significant` digits, but never fewer than stand before the decimal point."""
    if value is None:
        return _DASH
    if value == 0:
        return "0"
    whole = len(str(int(abs(value))))
    text = f"{value:.{max(significant, whole)}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return text.replace("-", "−")


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
