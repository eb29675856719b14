"""`hilbench convert` and `hilbench dbc`: what other tools read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hilbench.apps.cli.options import ConfigArgument
from hilbench.errors import UnusableInputError
from hilbench.files import write_whole


def convert(
    source: Annotated[Path, Argument(metavar="FROM", help="recording (.mf4, .csv, .parquet) or trace (.log, …)")],
    target: Annotated[Path, Argument(metavar="TO", help="recording (or .mcap), or trace (.log, .asc, .blf, .trc)")],
    columns: Annotated[
        Path | None, Option(metavar="FILE", help="mapping file (YAML): which column of another machine is what")
    ] = None,
    allow_loss: Annotated[
        bool, Option("--allow-loss", help="of a trace: write it although the format does not hold all of it")
    ] = False,
) -> None:
    """Write a recording or a trace in another format; bring a recording of another machine in.

    What is read is never written over. Columns that are no channel are told on standard error. What a format does not
    hold of a trace (CAN FD, remote and error frames in .trc) is told: exit code 1 and no file, or --allow-loss.

    Example: hilbench convert runs/web_section_step-20260101-120000/recording.mf4 run.parquet

    Example: hilbench convert runs/web_section_step-20260101-120000/trace.log trace.asc

    Example: hilbench convert runs/web_section_step-20260101-120000/recording.mf4 run.mcap

    Example: hilbench convert machine.csv recording.mf4 --columns columns.yaml
    """
    from hilbench.apps.cli.columns import report, report_unknown
    from hilbench.results.import_mapping import read_foreign
    from hilbench.results.recording import convert_recording, read_recording, write_recording
    from hilbench.results.trace_files import FORMATS, convert_trace

    for read in (source, columns):
        if read is not None and read.exists() and target.exists() and read.samefile(target):  # by any path, or link
            raise UnusableInputError(target, f"is what is read ({read}), expected another file to write")
    if source.suffix.lower() in FORMATS and columns is None:
        count = convert_trace(source, target, lambda text: report(source, text), allow_loss=allow_loss)
        print(f"{target}: {count} frames")
        return
    if columns is None and target.suffix.lower() != ".mcap":
        samples, names = convert_recording(source, target)
        report_unknown(names, source)
        print(f"{target}: {samples} samples of {len(names)} channels")
        return
    if columns is None:
        recording = read_recording(source)
        report_unknown(recording.channels, source)
    else:
        recording = read_foreign(source, columns, lambda text: report(source, text))
    if target.suffix.lower() == ".mcap":
        from hilbench.apps.streams.sinks import write_mcap

        write_mcap(recording, target)
    else:
        write_recording(recording, target)
    print(f"{target}: {len(recording)} samples of {len(recording.channels)} channels")


def dbc(
    config: ConfigArgument, out: Annotated[Path | None, Option(help="file; standard output without it")] = None
) -> None:
    """Write the PDO set of a bench as a DBC file, with SI units, for tools that decode the bus.

    It is plain ASCII (Nm, rad/s^2), because DBC files do not say how they are encoded.

    Example: hilbench dbc bench_configs/web_section_step.yaml --out web_section.dbc
    """
    from hilbench.exchange.pdo_set import pdo_set_dbc
    from hilbench.runs.config import load

    text = pdo_set_dbc(load(config)[0])
    if out is None:
        print(text, end="")
        return
    write_whole(out, text)
