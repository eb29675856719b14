"""The page of a diagnosis: verdict, effects, the gap before and after, where the model disagreed."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.diagnosis.diagnosis import Diagnosis
from hilbench.diagnosis.live import LiveGap
from hilbench.errors import UnusableInputError
from hilbench.report.chart import BLUE, VERMILLION, Chart, Curve, Mark
from hilbench.report.html import figure, number, page, section, table
from hilbench.report.live import interactive
from hilbench.report.plots import Panel, Picture, drawn, render_picture
from hilbench.report.reduce import moving_average

_SENTENCES = {
    "complete": "Nothing is missing that these data can show.",
    "named": "The effects below close the gap on data that no fit has seen.",
    "unknown": "Something is missing that no effect of the vocabulary explains.",
}
#: What is shown of a run, by its name in `LiveGap`.
LIVE_ROWS = (
    ("torque residual, rms, N·m", "torque_residual_rms_Nm"),
    ("true tension less set-point, rms, N", "tension_error_rms_N"),
    ("simulated less true tension, mean, N", "tension_deviation_mean_N"),
    ("bias of E, %", "E_bias_pct"),
)
#: Residuals are averaged over this time in the pictures, s: the noise of single samples would hide what is left.
_SMOOTHING_S = 0.2


def write_diagnosis_page(
    found: Diagnosis, live: list[LiveGap], not_compared: str, title: str, path: Path, config: Path | None
) -> Path:
    """Write the page. Raises UnusableInputError if it cannot be written.

    `not_compared`: why there is no second run of the bench to compare; `config`: the bench config that was written with
    the extended model in it, where there is one.
    """
    residuals = _residuals(found)
    body = [
        f"<header>\n<h1>{escape(title)}</h1>\n"
        f'<p class="facts">{found.verdict}: {_SENTENCES[found.verdict]}</p>\n{_made_by(found)}</header>',
        section("Effects", _effects(found)) if found.effects else "",
        section("Gap", _gaps(found)),
        section("Residuals", '<div class="zooms" hidden></div>\n' + figure(residuals)),
        section("Against what it depends on", _profiles(found)) if found.profiles else "",
        section("The twin on the bench", _live(live, not_compared)) if live else "",
        section("Where the model disagreed", _where(found)) if found.where else "",
        section("Not explained", _unexplained(found)) if found.unexplained else "",
        section("What these data could not show", _unobservable(found)) if found.unobservable else "",
        section("The extended model in use", _use(config)) if found.effects else "",
        interactive([residuals], _held_out(found)),
    ]
    try:
        path.write_text(page(title, body), encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(path, f"cannot be written ({error.strerror}), expected a writable folder") from error
    return path


def _made_by(found: Diagnosis) -> str:
    if found.imitation is None:
        return ""
    cycle_ms = 1e3 * found.imitation.cycle_s
    return f'<p class="facts">A bench’s recording: the web was imitated by a load motor, every {cycle_ms:g} ms.</p>\n'


def _row(*cells: str, numbers: int = 0) -> str:
    """A table row whose last `numbers` cells are numbers."""
    split = len(cells) - numbers
    text = "".join(f"<td>{escape(cell)}</td>" for cell in cells[:split])
    figures = "".join(f'<td class="number">{escape(cell)}</td>' for cell in cells[split:])
    return f"<tr>{text}{figures}</tr>"


def _effects(found: Diagnosis) -> str:
    lines, notes = [], []
    for effect in found.effects:
        place = f" of axis {effect.axis}" if effect.axis else ""
        for name, value in effect.parameters.items():
            said, low, high = (number(each, value.digits) for each in (value.value, *value.ci95))
            unit = "" if value.unit == "1" else value.unit
            cells = (said, f"{low} to {high}")
            lines.append(_row(effect.effect + place, name, unit, *cells, numbers=2))
        if effect.tied_with:
            text = (
                f"{effect.effect}{place} can’t be told from {', '.join(effect.tied_with)} by these data; "
                f"the experiment that would: {effect.told_apart_by}."
            )
            notes.append(f'<p class="note">{escape(text)}</p>')
    return table(("Effect", "Parameter", "Unit", ">Value", ">95 %"), lines) + "".join(notes)


def _gaps(found: Diagnosis) -> str:
    lines = [
        _row(
            g.signal,
            number(g.before),
            number(g.after),
            number(g.noise_floor),
            number(g.after / g.noise_floor, 3),
            numbers=4,
        )
        for g in found.gaps
    ]
    note = '<p class="note">Rms in N·m on stretches that no fit has seen.</p>'
    return table(("Signal", ">Before", ">After", ">Noise floor", ">After / floor"), lines) + note


def _live(live: list[LiveGap], not_compared: str) -> str:
    lines = [_row(title, *(number(getattr(g, name)) for g in live), numbers=len(live)) for title, name in LIVE_ROWS]
    shown = table(("While the line worked", ">Original model", ">Extended model")[: 1 + len(live)], lines)
    return shown + (f'<p class="note">Not compared: {escape(not_compared)}.</p>' if not_compared else "")


def _use(config: Path | None) -> str:
    """How a bench gets the extended model; the files are in the page's folder."""
    lines = [
        "<p><code>model_extended.yaml</code> is the model with the effects above. A bench whose twin has it is made by"
        " including it after the bench’s own config, because the later file counts:</p>",
        "<pre>include: [my_bench.yaml, model_extended.yaml]\nname: my_bench_extended</pre>",
    ]
    if config is not None:
        lines.append(
            f"<p>For the bench of this diagnosis that is <code>{escape(config.name)}</code>:</p>"
            f"<pre>hilbench run {escape(str(config))}</pre>"
        )
    return "\n".join(lines)


def _residuals(found: Diagnosis) -> Picture:
    width = max(1, round(_SMOOTHING_S / float(np.median(np.diff(found.t_s)))))
    charts = []
    for k, name in enumerate(found.names):
        if name.startswith("tau"):
            before, after = (moving_average(r[k], width) for r in (found.before, found.after))
            curves = [Curve("before", found.t_s, before, BLUE, 0.9), Curve("after", found.t_s, after, VERMILLION, 0.9)]
            charts.append(Chart(f"{name.removesuffix('_Nm')} in N·m", curves))
    caption = (
        f"Measured less simulated torque, averaged over {_SMOOTHING_S:g} s, with the original model and with the "
        "effects that were found; grey: held out of every fit."
    )
    return drawn(Picture("diagnosis", "Torque residuals", caption, charts), _held_out(found))


def _held_out(found: Diagnosis) -> list[Mark]:
    return [Mark(float(found.t_s[a]), float(found.t_s[b]), "") for a, b in _stretches(found.held_out)]


def _profiles(found: Diagnosis) -> str:
    rows = (len(found.profiles) + 1) // 2

    def draw(figure: Any) -> list[Panel]:
        figure.subplots_adjust(right=0.985, hspace=0.62, wspace=0.3)
        grid = np.atleast_1d(figure.subplots(rows, 2)).ravel()
        for axes in grid[len(found.profiles) :]:
            axes.set_visible(False)
        for axes, profile in zip(grid, found.profiles, strict=False):
            axes.plot(profile.at, profile.before, "o-", color=BLUE, markersize=3.0)
            axes.plot(profile.at, profile.after, "o-", color=VERMILLION, markersize=3.0)
            axes.set_xlabel(f"{profile.condition}, {profile.unit}")
        grid[0].set_ylabel(f"{found.profiles[0].signal.removesuffix('_Nm')}, N·m")
        return []

    svg = render_picture(draw, 2.3 * rows, "profiles", "Mean torque residual over states")
    note = (
        '<p class="note">Mean of measured less simulated torque over the states on which it depended most: '
        "blue with the original model, orange with the effects that were found.</p>"
    )
    return svg + note


def _stretches(held_out: Any) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held_out.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _where(found: Diagnosis) -> str:
    lines = [_row(w.signal, w.condition, w.when, f"{100.0 * w.share_of_gap:.0f} %", numbers=1) for w in found.where]
    return table(("Signal", "Condition", "When", ">Share of gap"), lines)


def _unexplained(found: Diagnosis) -> str:
    lines = [_row(m.signal, m.condition, m.detail, number(m.excess, 3), numbers=1) for m in found.unexplained]
    note = '<p class="note">Excess of the statistic over its expectation under noise alone.</p>'
    return table(("Signal", "Depends on", "Detail", ">Excess"), lines) + note


def _unobservable(found: Diagnosis) -> str:
    lines = [
        _row(
            b.effect + (f" of axis {b.axis}" if b.axis else ""),
            b.experiment,
            "never" if b.smallest_visible is None else f"{number(b.smallest_visible, 3)} {b.unit}",
            numbers=1,
        )
        for b in found.unobservable
    ]
    return table(("Effect", "Next experiment", ">Smallest visible"), lines)
