"""`hilbench sync`: synchronizers side by side on a recording, or each on a run of a bench."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hilbench.apps.cli.columns import report, report_section, report_unknown
from hilbench.apps.cli.model_option import model_from, web_line_of
from hilbench.apps.cli.options import print_json
from hilbench.apps.cli.tables import table
from hilbench.apps.sweep.sweep import Row, Sweep
from hilbench.apps.sync.page import COLUMNS, ESTIMATES, rows, write_comparison
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED, BenchFaultError, UnusableInputError
from hilbench.estimation.web_line.offline import remarks
from hilbench.files import make_folder
from hilbench.results.recording import Recording, check_recording, read_recording, read_section
from hilbench.results.run_folder import RunFolder
from hilbench.results.web_line_synchronization import (
    SETTLED_AFTER_S,
    Comparison,
    compare_methods,
    compare_runs,
    measurements_of,
    methods_of,
    require_one_span,
)
from hilbench.runs.config import load
from hilbench.runs.figures import finite_or_none

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
    for number, name in enumerate(chosen):
        row = sweep.rows[number]
        if row.run is None or row.exit_code not in (EXIT_PASSED, EXIT_CRITERION_FAILED):
            raise BenchFaultError(f"{name}: the run ended with exit code {row.exit_code}: {row.said}")
        recordings[name] = read_recording(RunFolder(folder / row.run).recording)
    comparison = compare_runs(web_line_of(config.machine, config_path), recordings)
    _show(comparison, write_comparison(comparison, f"Synchronizers on {config_path.name}", folder), as_json)


def _section(path: Path) -> Recording:
    recording = read_section(path)
    check_recording(recording, path)
    report_section(recording, path)
    return recording


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
    model, recording = web_line_of(model_from(model_path), model_path), _section(recording_path)
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
