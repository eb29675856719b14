"""`hilbench sync`: synchronizers side by side on a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hilbench.cli.model_option import model_from
from hilbench.errors import UnusableInputError
from hilbench.experiment.synchronization import Comparison, compare_methods, measurements_of, methods_of
from hilbench.record.recording import read_recording
from hilbench.report.sync_page import COLUMNS, rows, write_sync_page


def sync_command(
    recording_path: Path,
    model_path: Path,
    methods: str,
    out: Path | None,
    unmodelled_torque_Nm: float | None,
    *,
    as_json: bool,
) -> None:
    """Compare, print, and write the page into `out`. Raises UnusableInputError for what can't be used."""
    chosen = methods_of(methods)
    model, recording = model_from(model_path), read_recording(recording_path)
    data = measurements_of(recording, recording_path)
    if out is not None:  # before what takes its time
        _make_folder(out)
    true = np.asarray(recording["E_true_Pa"], np.float64) if "E_true_Pa" in recording else None
    try:
        comparison = compare_methods(model, data, chosen, true, unmodelled_torque_Nm)
    except ValueError as error:
        raise UnusableInputError(model_path, f"{error}") from error
    if out is not None:
        page = write_sync_page(comparison, f"Synchronizers on {recording_path.name}", out / "sync.html")
    if as_json:
        print(json.dumps(as_data(comparison), indent=2))
        return
    console = Console(highlight=False)
    console.print(_table(comparison))
    if out is not None:
        console.print(f"page: {page}")


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableInputError(out, f"cannot be made ({error.strerror}), expected a folder") from error


def _table(comparison: Comparison) -> Table:
    shown = Table(title=f"torque noise {comparison.noise_Nm:.3g} N·m", title_justify="left")
    for column in COLUMNS:
        numbers = column.startswith(">")
        shown.add_column(column.lstrip(">"), justify="right" if numbers else "left", no_wrap=not numbers)
    for row in rows(comparison):
        shown.add_row(*row)
    return shown


def as_data(comparison: Comparison) -> dict[str, Any]:
    """What `--json` prints; names with units, None where there is no true E."""
    return {
        "torque_noise_Nm": comparison.noise_Nm,
        "step_s": comparison.step_s,
        "bound": {
            "time_to_1pct_s": comparison.bound_time_to_1pct_s,
            "final_deviation_Pa": float(comparison.bound_sd_Pa[-1]),
        },
        "methods": [
            {
                "method": result.method,
                "time_to_1pct_s": result.time_to_1pct_s,
                "overshoot_pct": result.overshoot_pct,
                "noise_pct": result.noise_pct,
                "bias_pct": result.bias_pct,
                "largest_error_pct": result.largest_error_pct,
                "covered": result.covered,
                "final_E_Pa": result.final_E_Pa,
                "final_deviation_Pa": result.final_sd_Pa,
                "cpu_us_per_cycle": result.cpu_us,
                "also": {
                    name: {"value": float(values[0][-1]), "deviation": float(values[1][-1])}
                    for name, values in result.track.nuisances.items()
                },
            }
            for result in comparison.results
        ],
    }
