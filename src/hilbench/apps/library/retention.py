"""Runs that go: deleted by name, or by what is to be kept."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hilbench.apps.library.index import RunEntry, is_run
from hilbench.apps.library.live_run import continues
from hilbench.errors import UnusableInputError
from hilbench.files import usable
from hilbench.results.run_folder import RunFolder


@dataclass(frozen=True)
class Keep:
    """Bounds of what is kept of a library; None: no bound.

    A run goes when it is older than `younger_than_s`, or when all younger runs together have filled `size_bytes`
    already. It stays whatever these say when it is among the `last` of its bench, has one of the reasons to be kept
    (`labelled`: any tag or note), or goes on.
    """

    younger_than_s: float | None = None
    size_bytes: int | None = None
    last: int = 0
    labelled: bool = True


def to_clear(runs: Sequence[RunEntry], keep: Keep, now_s: float) -> list[tuple[RunEntry, str]]:
    """Runs of a library to be cleared, the oldest first, each with the reason."""
    newest_first = sorted(runs, key=lambda run: (run.began_s, run.path), reverse=True)
    of_bench: dict[str, int] = {}
    goes: list[tuple[RunEntry, str]] = []
    kept_bytes = 0
    for run in newest_first:
        of_bench[run.bench] = number = of_bench.get(run.bench, 0) + 1
        why = _why(run, keep, now_s, kept_bytes)
        stays = number <= keep.last or (keep.labelled and (run.tags or run.notes)) or run.state == "running"
        if why and not stays:
            goes.append((run, why))
        else:
            kept_bytes += run.size_bytes
    return goes[::-1]


def _why(run: RunEntry, keep: Keep, now_s: float, kept_bytes: int) -> str:
    age_s = now_s - run.began_s
    if keep.younger_than_s is not None and age_s > keep.younger_than_s:
        return f"{age_s / 86400.0:.0f} days old"
    if keep.size_bytes is not None and kept_bytes + run.size_bytes > keep.size_bytes:
        return "beyond the size"
    return ""


def check_deletable(path: Path) -> None:
    """Raises UnusableInputError for what is no run folder, a link, one that holds other runs, or a run that goes on."""
    if path.is_symlink():
        raise UnusableInputError(path, "is a link, expected a run folder itself")
    if not is_run(path):
        raise UnusableInputError(path, "is no run folder, expected one with a config and a trace, journal or result")
    for below in path.rglob("*/"):
        if is_run(below) or below.name == ".git":
            raise UnusableInputError(path, f"holds {below.relative_to(path)}, expected a run folder and nothing else")
    if continues(RunFolder(path)):
        raise UnusableInputError(path, "its bench runs, expected a run that has ended")


def delete(path: Path) -> None:
    """Delete a run folder with all that is in it. Raises UnusableInputError for what is none, or can't be deleted.

    It is taken out of sight first: a process that is killed meanwhile leaves no half of a run behind that looks whole.
    """
    check_deletable(path)
    path = path.resolve()
    going = path.with_name(f".deleted.{os.getpid()}.{path.name}")
    with usable(path, "deleted", "a folder of one's own"):
        path.rename(going)
        shutil.rmtree(going)


def delete_all(paths: Sequence[Path]) -> dict[Path, UnusableInputError]:
    """Delete run folders, past those that can't be deleted: these, and why."""
    left = {}
    for path in paths:
        try:
            delete(path)
        except UnusableInputError as error:
            left[path] = error
    return left
