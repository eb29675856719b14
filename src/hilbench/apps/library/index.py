"""The index of the runs in a folder: one JSON file of what the run folders say, made again whenever it can't be used.

Nothing is only there: all data of a run are in its folder, tags and notes as well. A folder is opened again when it,
its result or its labels have changed; otherwise a listing looks at three times of change a run. Several processes may
use it at a time: the file is replaced as a whole, and what the last one did not know is read again. Where the folder
can't be written, nothing is kept.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final, Literal, NamedTuple

from pydantic import Field, ValidationError

from hilbench.apps.library.entry import RunEntry, read_entry
from hilbench.block import Strict
from hilbench.errors import UnusableInputError
from hilbench.files import written_whole

#: Its name in the folder of the runs.
FILE: Final = ".runs.json"
#: Folders below that of the runs in which runs are looked for (sweeps have theirs deeper).
_DEEPEST: Final = 4
#: From so many folders that are to be read on, a line announces that it takes a while.
_MANY: Final = 300


class _Kept(NamedTuple):
    """A run as its folder had it when it had this stamp."""

    stamp: str
    entry: RunEntry


class _Runs(Strict):
    """Content of the file: the runs by their paths."""

    version: Literal[4] = 4  #: another one with each change of `RunEntry`
    runs: dict[str, _Kept] = Field(default_factory=dict)


def runs_in(base: Path, announce: Callable[[str], None]) -> list[RunEntry]:
    """Runs in a folder as they are now, the newest first. `announce` gets a line when many folders are to be read."""
    known = _read(base / FILE)
    found = dict(_run_folders(base, known))
    kept = {path: known[path] for path, stamp in found.items() if path in known and known[path].stamp == stamp}
    changed = found.keys() - kept.keys()
    if len(changed) >= _MANY:
        announce(f"{base}: reading {len(changed)} runs into the index")
    kept |= {path: _Kept(found[path], read_entry(base, path)) for path in changed}
    if changed or known.keys() - found.keys():
        with suppress(UnusableInputError), written_whole(base / FILE) as partial:
            partial.write_bytes(_Runs(runs=kept).model_dump_json().encode())
    return sorted((each.entry for each in kept.values()), key=lambda run: (run.began_s, run.path), reverse=True)


def _read(path: Path) -> dict[str, _Kept]:
    with suppress(OSError, ValidationError):
        return _Runs.model_validate_json(path.read_bytes()).runs
    return {}


def _run_folders(base: Path, known: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Path and stamp of each run folder below `base`; links are not followed."""
    waiting = [("", 1)]
    known = {*known}
    while waiting:
        below, depth = waiting.pop()
        try:
            with os.scandir(base / below) as found:
                entries = list(found)
        except OSError:  # it has gone, or is somebody else's
            continue
        for entry in entries:
            if entry.name.startswith(".") or not entry.is_dir(follow_symlinks=False):
                continue
            path = f"{below}{entry.name}"
            shown = os.fsencode(path).decode(errors="backslashreplace")  # what is no UTF-8 can't be kept
            if shown in known or is_run(entry.path):
                stamp = _stamp(entry.path)
                if stamp is not None:
                    yield shown, stamp
            elif depth < _DEEPEST:
                waiting.append((f"{path}/", depth + 1))


def is_run(path: str | Path) -> bool:
    """True if a folder is that of a run: a config, and something that only a run leaves."""
    return os.path.isfile(f"{path}/config.yaml") and any(
        os.path.isfile(f"{path}/{name}") for name in ("trace.log", "result.json", "journal.log", "recording.mf4")
    )


def _stamp(path: str) -> str | None:
    """Changes when the run folder has changed; None when it is none any more."""
    try:
        stamp = str(os.stat(path).st_mtime_ns)
    except OSError:
        return None
    for name in ("result.json", "labels.json"):
        try:
            found = os.stat(f"{path}/{name}")
        except OSError:
            stamp += ",-"
        else:
            stamp += f",{found.st_mtime_ns}.{found.st_size}"
    return stamp
