"""Columns of a recording that are no channel, and notes on standard error about them: nobody would see it else."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import typer

from hilbench.did_you_mean import closest
from hilbench.results.recording import Recording, check_recording, read_section
from hilbench.topology.signals import example_names, unit_of


def report(path: Path, text: str) -> None:
    """A note on a file that is used all the same."""
    typer.echo(f"hilbench: {path}: {text}", err=True)


def reported_section(path: Path, *, checked: bool = False) -> Recording:
    """Read a recording (`read_section`, and `check_recording`); say which part of one that is too long is used.

    Raises UnusableInputError.
    """
    recording = read_section(path)
    if checked:
        check_recording(recording, path)
    if recording.is_reduced:
        first_s, last_s = recording.time_s[[0, -1]]
        report(path, f"{len(recording)} of its {recording.samples} samples are used, {first_s:g} to {last_s:g} s")
    return recording


def report_unknown(names: Collection[str], path: Path) -> None:
    """Say which columns, by these names, are no channel, and what may have been meant."""
    unknown = unknown_columns(names)
    if unknown:
        report(path, f"columns that are no channel: {', '.join(unknown)}")


def _without_numbers(name: str) -> str:
    return "".join(sign for sign in name if not sign.isdigit())


def unknown_columns(names: Collection[str]) -> list[str]:
    """Columns among these names that are no channel, each with the channel that may have been meant.

    A name that is not in the signal list, but ends in an SI unit, is a channel as well (`hilbench.topology.signals`),
    unless it is much like one that is missing. The same name with another number is that of another axis.
    """
    known_names = example_names()
    numbered = {_without_numbers(known) for known in known_names if _without_numbers(known) != known}
    missing = [known for known in known_names if known not in names]
    messages = []
    for name in names:
        meant = closest(name, [known for known in missing if _without_numbers(known) != _without_numbers(name)])
        of_another = _without_numbers(name) != name and _without_numbers(name) in numbered
        if name in known_names or (unit_of(name) and (of_another or not meant)):
            continue
        messages.append(f"'{name}'" + (f" (did you mean {meant[0]}?)" if meant else ""))
    return messages
