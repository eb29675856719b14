"""The page of a comparison of synchronizers: one table and one picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilbench.diagnosis.synchronization import Comparison
from hilbench.report.chart import (
    BLUE,
    BROWN,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    Band,
    Chart,
    Curve,
    Mark,
)
from hilbench.report.page import DASH, number, write_page
from hilbench.report.plots import Picture, drawn
from hilbench.runs.figures import ESTIMATE_BAND

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
    bound = [number(comparison.bound_time_to_1pct_s, 3), *[DASH] * 5, number(float(100.0 * sd / true), 2), DASH]
    return [*found, ["Cramér–Rao bound", *bound]]


def write_sync_page(comparison: Comparison, title: str, path: Path) -> Path:
    """Write the page. Raises UnusableInputError if it cannot be written."""
    shown = pictures(comparison)
    return write_page(
        path,
        "sync",
        shown[:1],
        _marks(comparison),
        title=title,
        noise_Nm=comparison.noise_Nm,
        sample_ms=1e3 * float(np.median(np.diff(comparison.t_s))),
        columns=COLUMNS,
        rows=rows(comparison),
        pictures=shown,
    )


def pictures(comparison: Comparison) -> list[Picture]:
    """Estimates over the whole recording, and around the last step of the true E."""
    caption = "Estimates" + (", and the true value with ±1 % (grey)" if comparison.E_true_Pa is not None else "")
    chart, marks = _chart(comparison), _marks(comparison)
    found = [drawn(Picture("sync", "Young’s modulus by method", caption, [chart]), marks)]
    if comparison.step_s is not None:
        around = chart.part(comparison.step_s - _BEFORE_S, comparison.step_s + _AFTER_S)
        found.append(drawn(Picture("sync-step", "Around the last step of E", "", [around]), marks))
    return found


def _marks(comparison: Comparison) -> list[Mark]:
    return [] if comparison.step_s is None else [Mark(comparison.step_s, comparison.step_s, "step of E", "1")]


def _chart(comparison: Comparison) -> Chart:
    t_s, bands, curves = comparison.t_s, [], []
    if comparison.E_true_Pa is not None:
        true = comparison.E_true_Pa / 1e6
        bands.append(Band(t_s, true * (1 - ESTIMATE_BAND), true * (1 + ESTIMATE_BAND), INK, 0.16))
        curves.append(Curve("true", t_s, true, PURPLE, 1.0))
    for result in comparison.results:
        curves.append(Curve(result.method, t_s, result.track.E_Pa / 1e6, COLOURS[result.method], 1.1))
    return Chart("E in N/mm²", curves, bands)
