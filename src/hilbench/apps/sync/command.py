"""`hilbench sync`: synchronizers compared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hilbench.apps.cli.options import JsonOption, ModelOption
from hilbench.errors import UnusableInputError


def sync(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="recording (.mf4, .csv, .csv.gz), or a bench config (.yaml) to run each method on"
        ),
    ],
    model: ModelOption = None,
    method: Annotated[str, typer.Option("--method", help="methods, comma-separated, or all")] = "all",
    out: Annotated[
        Path | None,
        typer.Option("--out", help="folder for the page and the estimates over time (CSV); a bench's runs, too (sync)"),
    ] = None,
    unmodelled_torque: Annotated[
        float | None,
        typer.Option(
            "--unmodelled-torque",
            min=0.0,
            metavar="N·m",
            help="all that the model may lack: a lasting error of the torque (standard deviation)",
            show_default="friction, scale and the rest are looked for",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="runs of a bench at a time")] = 1,
    json: JsonOption = False,
) -> None:
    """Compare synchronizers: time to 1 %, overshoot, noise, bias, coverage of intervals, cost, and the bound.

    On a recording every method sees the same samples. With a bench config each method has a run of its own, with real
    processes and frames and the tension loop closed on its twin.

    With --out: sync.html, and estimates.csv with t_s, METHOD_E_Pa and METHOD_E_sd_Pa (standard deviation) of each
    method in every row.

    Example: hilbench sync runs/web_section_step-20260101-120000/recording.mf4 --model model.yaml --out comparison

    Example: hilbench sync bench_configs/synchronizers.yaml --out comparison
    """
    from hilbench.apps.sync.compare import sync_command, sync_runs_command

    if source.suffix in (".yaml", ".yml"):
        sync_runs_command(source, method, out, jobs, as_json=json)
    elif model is None:
        raise UnusableInputError("--model", "missing, expected the model of the recorded machine")
    else:
        sync_command(source, model, method, out, unmodelled_torque, as_json=json)
