"""`hilbench sync`: synchronizers side by side on a recording, or each on a run of a bench."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hilbench.apps.cli.columns import report, report_unknown, reported_section
from hilbench.apps.cli.model_option import model_from, web_line_of
from hilbench.apps.cli.options import print_json
from hilbench.apps.cli.tables import table
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
from hilbench.apps.sweep.sweep import Row, Sweep
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED, BenchFaultError, UnusableInputError
from hilbench.estimation.web_line.offline import remarks
from hilbench.files import make_folder
from hilbench.results.recording import read_recording, write_recording
from hilbench.results.run_folder import RunFolder
from hilbench.results.web_line_synchronization import (
    INTERVAL,
    SETTLED_AFTER_S,
    Comparison,
    MethodResult,
    compare_methods,
    compare_runs,
    estimates,
    measurements_of,
    methods_of,
    require_one_span,
)
from hilbench.runs.config import load
from hilbench.runs.figures import ESTIMATE_BAND, finite_or_none

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
    curves, bands = _true(comparison)
    chart = Chart(_AXIS, [*curves, *(_curve(comparison, result) for result in comparison.results)], bands)
    marks = _marks(comparison)
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


#: The published method transfers no state; a quicker tension loop would only follow its errors.
_PUBLISHED, _PUBLISHED_BANDWIDTH = "pid", "3.0"


def sync_runs_command(config_path: Path, methods: str, out: Path | None, jobs: int, *, as_json: bool) -> None:
    """Run the bench once with each method, in processes and over frames, and compare what the twins said.

    The runs are kept in `out`; the same command again goes on where it was interrupted. Raises UnusableInputError for
    what can't be used, BenchFaultError when a run did not get to its end.
    """
    chosen = list(methods_of(methods))
    folder = out or Path("sync")
    config, _ = load(config_path)
    require_one_span(web_line_of(config.machine, config_path), config_path)
    runs = [{"twin.estimate": f"[{{method: {name}}}]"} for name in chosen]
    for name, changes in zip(chosen, runs, strict=True):
        if name == _PUBLISHED:
            changes["twin.transfer.strain"] = "false"
            loops = [each for each, control in config.controllers.items() if hasattr(control, "bandwidth_rad_per_s")]
            changes |= {f"controllers.{each}.bandwidth_rad_per_s": _PUBLISHED_BANDWIDTH for each in loops}
    sweep = Sweep(config_path, (), runs, folder)

    def done(row: Row) -> None:
        if not as_json:
            print(f"{chosen[row.number]}: {row.run or row.said}", file=sys.stderr, flush=True)

    sweep.run(jobs, done)
    recordings = {}
    for name, row in zip(chosen, (sweep.rows[at] for at in range(len(chosen))), strict=True):
        if row.run is None or row.exit_code not in (EXIT_PASSED, EXIT_CRITERION_FAILED):
            raise BenchFaultError(f"{name}: the run ended with exit code {row.exit_code}: {row.said}")
        recordings[name] = read_recording(RunFolder(folder / row.run).recording)
    comparison = compare_runs(web_line_of(config.machine, config_path), recordings)
    _show(comparison, write_comparison(comparison, f"Synchronizers on {config_path.name}", folder), as_json)


def sync_command(
    recording_path: Path,
    model_path: Path,
    methods: str,
    out: Path | None,
    unmodelled_torque_Nm: float | None,
    *,
    as_json: bool,
) -> None:
    """Compare, print, and write page and estimates into `out`. Raises UnusableInputError for what can't be used."""
    chosen = methods_of(methods)
    model, recording = web_line_of(model_from(model_path), model_path), reported_section(recording_path, checked=True)
    report_unknown(recording.channels, recording_path)
    require_one_span(model, model_path)
    data = measurements_of(recording, recording_path)
    length_s = float(data.t_s[-1] - data.t_s[0])
    if length_s <= SETTLED_AFTER_S:
        raise UnusableInputError(
            recording_path, f"{length_s:g} s long, expected more than {SETTLED_AFTER_S:g} s, in which a twin settles"
        )
    if out is not None:  # before what takes its time
        make_folder(out)
    for remark in remarks(model, data):
        report(recording_path, remark)
    true = np.asarray(recording["E_true_Pa"], np.float64) if "E_true_Pa" in recording else None
    try:
        comparison = compare_methods(model, data, chosen, true, unmodelled_torque_Nm)
    except ValueError as error:
        raise UnusableInputError(model_path, f"{error}") from error
    page = None
    if out is not None:
        page = write_comparison(comparison, f"Synchronizers on {recording_path.name}", out)
    _show(comparison, page, as_json)


def _show(comparison: Comparison, page: Path | None, as_json: bool) -> None:
    if as_json:
        print_json(as_data(comparison))
        return
    console = Console(highlight=False)
    columns = [column.replace(", ", "\n") for column in COLUMNS]  # units below: the figures stay whole in 80 columns
    title = f"torque noise {comparison.noise_Nm:.3g} N·m"
    console.print(table(columns, rows(comparison), columns, title=title, padding=(0, 1, 0, 0)))
    if page is not None:
        console.print(f"page: {page}", soft_wrap=True)
        console.print(f"estimates: {page.with_name(ESTIMATES)}", soft_wrap=True)


#: Of a method's result, what `--json` prints as it is.
_AS_THEY_ARE = (
    *("method", "time_to_1pct_s", "overshoot_pct", "noise_pct", "bias_pct", "largest_error_pct", "covered"),
    "final_E_Pa",
)


def as_data(comparison: Comparison) -> dict[str, Any]:
    """Data that `--json` prints; names with units, None where there is no true E or no finite value."""
    return {
        "torque_noise_Nm": comparison.noise_Nm,
        "step_s": comparison.step_s,
        "bound": {
            "time_to_1pct_s": comparison.bound_time_to_1pct_s,
            "final_deviation_Pa": finite_or_none(comparison.bound_sd_Pa[-1]),
        },
        "methods": [
            {
                **{name: getattr(result, name) for name in _AS_THEY_ARE},
                "final_deviation_Pa": finite_or_none(result.final_sd_Pa),
                "cpu_us_per_cycle": result.cpu_us,
                "also": {
                    name: {"value": finite_or_none(values[0][-1]), "deviation": finite_or_none(values[1][-1])}
                    for name, values in result.track.nuisances.items()
                },
            }
            for result in comparison.results
        ],
    }
