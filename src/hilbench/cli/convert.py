"""`hilbench convert` and `hilbench dbc`: what other tools read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hilbench.cli.options import ConfigArgument


def convert(
    source: Annotated[Path, typer.Argument(metavar="FROM", help="recording (.mf4, .csv, .parquet) or trace (.log, …)")],
    target: Annotated[Path, typer.Argument(metavar="TO", help="recording, or trace (.log, .asc, .blf, .trc)")],
    columns: Annotated[
        Path | None,
        typer.Option("--columns", metavar="FILE", help="mapping file (YAML): which column of another machine is what"),
    ] = None,
) -> None:
    """Write a recording or a trace in another format; bring a recording of another machine in.

    Example: hilbench convert runs/web_section_step-20260101-120000/recording.mf4 run.parquet

    Example: hilbench convert runs/web_section_step-20260101-120000/trace.log trace.asc

    Example: hilbench convert machine.csv recording.mf4 --columns columns.yaml
    """
    from hilbench.record.foreign import read_foreign
    from hilbench.record.recording import read_recording, write_recording
    from hilbench.record.trace_files import FORMATS, read_trace, write_trace

    if source.suffix.lower() in FORMATS and columns is None:
        print(f"{target}: {write_trace(read_trace(source), target, 'can0')} frames")
        return
    recording = read_recording(source) if columns is None else read_foreign(source, columns)
    write_recording(recording, target)
    print(f"{target}: {len(recording)} samples of {len(recording.channels)} channels")


def dbc(
    config: ConfigArgument,
    out: Annotated[Path | None, typer.Option("--out", help="file; standard output without it")] = None,
) -> None:
    """Write the PDO set of a bench as a DBC file, with SI units, for tools that decode the bus.

    Example: hilbench dbc bench_configs/web_section_step.yaml --out web_section.dbc
    """
    from hilbench.bench.pdo_set import pdo_set_dbc
    from hilbench.errors import UnusableInputError
    from hilbench.experiment.config import load

    text = pdo_set_dbc(load(config)[0])
    if out is None:
        print(text, end="")
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(out, f"cannot be written ({error.strerror}), expected a writable folder") from error
