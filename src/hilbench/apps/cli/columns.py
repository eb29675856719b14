"""Notes on standard error about columns of a recording that are not used."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import typer

from hilbench.results.columns import unknown_columns
from hilbench.results.recording import Recording


def report(path: Path, text: str) -> None:
    """A note on a file that is used all the same."""
    typer.echo(f"hilbench: {path}: {text}", err=True)


def report_section(recording: Recording, path: Path) -> None:
    """Say which part of a recording that is too long is used."""
    if recording.is_reduced:
        first_s, last_s = recording.time_s[[0, -1]]
        report(path, f"{len(recording)} of its {recording.samples} samples are used, {first_s:g} to {last_s:g} s")


def report_unknown(names: Collection[str], path: Path) -> None:
    """Say which columns, by these names, are no channel, and what may have been meant."""
    unknown = unknown_columns(names)
    if unknown:
        report(path, f"columns that are no channel: {', '.join(unknown)}")
