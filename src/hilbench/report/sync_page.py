"""The page of a comparison of synchronizers: one table and one picture."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.errors import UnusableInputError
from hilbench.experiment.metrics import E_BAND
from hilbench.experiment.synchronization import Comparison
from hilbench.report.html import number, page, section, table
from hilbench.report.plots import (
    BLUE,
    BROWN,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    Panel,
    Picture,
    render_picture,
)

COLOURS = {
    "pid": INK,
    "lm": BLUE,
    "global": SKY,
    "rls": GREEN,
    "ekf": ORANGE,
    "changepoint": VERMILLION,
    "input": BROWN,
}
#: Time around the step that the lower half of the picture shows, s.
_BEFORE_S, _AFTER_S = 0.1, 0.6

COLUMNS = (
    "Method",
    ">to 1 %, s",
    ">overshoot, %",
    ">noise, %",
    ">bias, %",
    ">95 % holds, %",
    ">E, N/mm²",
    ">±, %",
    ">µs",
)


def rows(comparison: Comparison) -> list[list[str]]:
    """The table's text, a row a method, with the bound as the last row."""
    found = []
    for result in comparison.results:
        covered = None if result.covered is None else 100.0 * result.covered
        values = (result.time_to_1pct_s, result.overshoot_pct, result.noise_pct, result.bias_pct, covered)
        final = (result.final_E_Pa / 1e6, 100.0 * result.final_sd_Pa / result.final_E_Pa, result.cpu_us)
        found.append([result.method, *(number(value, 3) for value in (*values, *final))])
    sd = comparison.bound_sd_Pa[-1]
    true = comparison.results[0].final_E_Pa if comparison.E_true_Pa is None else comparison.E_true_Pa[-1]
    bound = [number(comparison.bound_time_to_1pct_s, 3), *["–"] * 5, number(float(100.0 * sd / true), 2), "–"]
    return [*found, ["Cramér–Rao bound", *bound]]


def write_sync_page(comparison: Comparison, title: str, path: Path) -> Path:
    """Write the page. Raises UnusableInputError if it cannot be written."""
    body = [
        f"<header>\n<h1>{escape(title)}</h1>\n"
        f'<p class="facts">torque noise {number(comparison.noise_Nm)} N·m per sample of '
        f"{number(1e3 * float(np.median(np.diff(comparison.t_s))))} ms</p>\n</header>",
        section("Methods", _table(comparison)),
        section("Estimates", picture(comparison).svg),
    ]
    try:
        path.write_text(page(title, body), encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(path, f"cannot be written ({error.strerror}), expected a writable folder") from error
    return path


def _table(comparison: Comparison) -> str:
    lines = []
    for first, *others in rows(comparison):
        cells = "".join(f'<td class="number">{escape(text)}</td>' for text in others)
        lines.append(f"<tr><td>{escape(first)}</td>{cells}</tr>")
    note = (
        '<p class="note">Overshoot as a share of the step; noise about the trend, bias and interval from 1 s after the '
        "last step of E on; how often ±1.96 deviations as stated by the method hold the true E; E at the end and its "
        "deviation; CPU time per cycle. The bound: two of its deviations within 1 %, and its deviation at the end.</p>"
    )
    return table(COLUMNS, lines) + note


def picture(comparison: Comparison) -> Picture:
    """Estimates over the whole recording, and around the last step of the true E."""
    t_s, true = comparison.t_s, comparison.E_true_Pa
    zoomed = comparison.step_s is not None

    def draw(figure: Any) -> list[Panel]:
        axes = figure.subplots(2, 1) if zoomed else [figure.subplots()]
        panels = [_draw(comparison, axes[0], slice(0, len(t_s)))]
        if comparison.step_s is not None:
            ends = np.searchsorted(t_s, [comparison.step_s - _BEFORE_S, comparison.step_s + _AFTER_S])
            panels.append(_draw(comparison, axes[1], slice(int(ends[0]), int(ends[1]))))
        panels[-1].axes.set_xlabel("time in s")
        return panels

    title = "Young’s modulus by method"
    caption = "Estimates" + (", and the true value with ±1 % (grey)" if true is not None else "")
    return Picture(title, caption, render_picture(draw, 5.6 if zoomed else 3.2, "sync", title))


def _draw(comparison: Comparison, axes: Any, part: slice) -> Panel:
    panel = Panel(axes, comparison.t_s[part])
    shown = []
    if comparison.E_true_Pa is not None:
        true = comparison.E_true_Pa[part] / 1e6
        panel.band(true * (1 - E_BAND), true * (1 + E_BAND), INK, 0.16)
        panel.line(true, "true", PURPLE, linewidth=1.0)
        shown.append(true)
    for result in comparison.results:
        estimate = result.track.E_Pa[part] / 1e6
        panel.line(estimate, result.method, COLOURS[result.method], linewidth=1.1)
        shown.append(estimate)
    panel.limits(*shown, part=slice(None), margin=0.1)
    panel.axes.set_xlim(panel.t_s[0], panel.t_s[-1])
    panel.axes.set_ylabel("E in N/mm²")
    return panel
