"""Files of a comparison of synchronizers: a page with a table and pictures, and the estimates as CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilbench.apps.report.chart import (
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
from hilbench.apps.report.page import DASH, number, write_page
from hilbench.apps.report.plots import Picture, drawn
from hilbench.results.recording import write_recording
from hilbench.results.web_line_synchronization import INTERVAL, Comparison, MethodResult, estimates
from hilbench.runs.figures import ESTIMATE_BAND

#: The page, and beside it the estimates of all methods over time.
PAGE, ESTIMATES = "sync.html", "estimates.csv"
COLOURS = {
    "pid": INK,
    "lm": BLUE,
    "global": SKY,
    "rls": GREEN,
    "ekf": ORANGE,
    "changepoint": VERMILLION,
    "input": BROWN,
}
_AXIS = "E in N/mm²"
#: Height of the axes at least, in median widths of the interval: its edges show where it is not much wider than usual.
_ROOM = 1.5
#: Time around the step that the lower half of the picture shows, s.
_BEFORE_S, _AFTER_S = 0.1, 0.6

COLUMNS = (
    *("Method", ">to 1 %, s", ">overshoot, %", ">noise, %", ">bias, %", ">95 % holds, %"),
    *(">E, N/mm²", ">±, %", ">µs"),
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


def write_comparison(comparison: Comparison, title: str, folder: Path) -> Path:
    """Write the estimates as `estimates.csv`, and `sync.html`, which shows and links them. Returns the page.

    Raises UnusableInputError if one of them cannot be written.
    """
    write_recording(estimates(comparison), folder / ESTIMATES)
    shown = pictures(comparison)
    return write_page(
        folder / PAGE,
        "sync/sync",
        shown[:2],
        _marks(comparison),
        title=title,
        estimates=ESTIMATES,
        noise_Nm=comparison.noise_Nm,
        sample_ms=1e3 * float(np.median(np.diff(comparison.t_s))),
        columns=COLUMNS,
        rows=rows(comparison),
        pictures=shown,
    )


def pictures(comparison: Comparison) -> list[Picture]:
    """Estimates over the whole recording, each with its 95 % interval, and all around the last step of the true E."""
    true = "" if comparison.E_true_Pa is None else ", and the true value with ±1 % (grey)"
    chart, marks = _chart(comparison), _marks(comparison)
    intervals = [_interval_chart(comparison, result) for result in comparison.results]
    stated = f"Estimate ± {INTERVAL} standard deviations as the method states them{true}"
    found = [
        drawn(Picture("sync", "Young’s modulus by method", f"Estimates{true}", [chart]), marks),
        drawn(Picture("sync-intervals", "Young’s modulus with its 95 % interval", stated, intervals), marks),
    ]
    if comparison.step_s is not None:
        around = chart.part(comparison.step_s - _BEFORE_S, comparison.step_s + _AFTER_S)
        found.append(drawn(Picture("sync-step", "Around the last step of E", "", [around]), marks))
    return found


def _marks(comparison: Comparison) -> list[Mark]:
    return [] if comparison.step_s is None else [Mark(comparison.step_s, comparison.step_s, "step of E", "1")]


def _chart(comparison: Comparison) -> Chart:
    curves, bands = _true(comparison)
    return Chart(_AXIS, [*curves, *(_curve(comparison, result) for result in comparison.results)], bands)


def _interval_chart(comparison: Comparison, result: MethodResult) -> Chart:
    """One method; an infinite interval is not drawn."""
    curves, bands = _true(comparison)
    finite = np.isfinite(result.track.E_sd_Pa)
    half = np.where(finite, INTERVAL * result.track.E_sd_Pa, np.nan) / 1e6
    modulus = result.track.E_Pa / 1e6
    low, high = modulus - half, modulus + half
    usual = float(np.median(high[finite] - low[finite])) if finite.any() else 0.0
    interval = Band(comparison.t_s, low, high, COLOURS[result.method], 0.25)
    return Chart(_AXIS, [*curves, _curve(comparison, result)], [*bands, interval], least=_ROOM * usual)


def _true(comparison: Comparison) -> tuple[list[Curve], list[Band]]:
    """The true E with its band, where the recording has it."""
    if comparison.E_true_Pa is None:
        return [], []
    t_s, true = comparison.t_s, comparison.E_true_Pa / 1e6
    band = Band(t_s, true * (1 - ESTIMATE_BAND), true * (1 + ESTIMATE_BAND), INK, 0.16)
    return [Curve("true", t_s, true, PURPLE, 1.0)], [band]


def _curve(comparison: Comparison, result: MethodResult) -> Curve:
    return Curve(result.method, comparison.t_s, result.track.E_Pa / 1e6, COLOURS[result.method], 1.1)
