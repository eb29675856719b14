"""What is said of a recording's columns that nobody uses, on standard error."""

from __future__ import annotations

from pathlib import Path

import typer

from hilbench.results.columns import unknown_columns
from hilbench.results.recording import Recording


def report(path: Path, text: str) -> None:
    """A note on a file that is used all the same."""
    typer.echo(f"hilbench: {path}: {text}", err=True)


def report_unknown(recording: Recording, path: Path) -> None:
    """Say which columns are no channel, and what may have been meant."""
    unknown = unknown_columns(list(recording.channels))
    if unknown:
        report(path, f"columns that are no channel: {', '.join(unknown)}")
