"""The index of the runs in a folder: one SQLite file, made again from the run folders whenever it is missing.

Nothing is only there: all data of a run are in its folder, tags and notes as well. A folder is opened again when it,
its result or its labels have changed; otherwise a listing looks at three times of change a run. Several processes may
use it at a time (write-ahead log, a waiting time for the lock, one transaction an update). Where the folder can't be
written, the index is made in memory, for this once.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Final, TypeVar

from hilbench.apps.library.database import connected
from hilbench.apps.library.entry import RunEntry, read_entry
from hilbench.errors import UnusableInputError

_Answer = TypeVar("_Answer")

#: Its name in the folder of the runs.
FILE: Final = ".runs.sqlite"
#: How long one waits for another who writes, s.
_PATIENCE_S: Final = 2.0
#: What says nothing against the file itself: it can't be read or written here, or somebody else holds it.
_OF_ANOTHER: Final = (
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
)
_VERSION: Final = 3
#: Folders below that of the runs in which runs are looked for (sweeps have theirs deeper).
_DEEPEST: Final = 4
_TABLES: Final = """
CREATE TABLE run (path TEXT PRIMARY KEY, stamp TEXT NOT NULL, began_s REAL NOT NULL, entry TEXT NOT NULL) STRICT;
CREATE TABLE metric (
    name TEXT NOT NULL, path TEXT NOT NULL, value REAL NOT NULL, PRIMARY KEY (name, path)
) STRICT, WITHOUT ROWID;
CREATE INDEX metric_of_run ON metric (path);
"""
#: From so many folders that are to be read on, a line announces that it takes a while.
_MANY: Final = 300


class Index:
    """The index of one folder of runs. `opened`: run folders that were read by `update`, in all."""

    def __init__(self, base: Path) -> None:
        if not base.is_dir():
            raise UnusableInputError(base, "no such folder, expected that in which the run folders are")
        self.base = base
        self.opened = 0

    def runs(
        self, metrics: Iterable[str] | None = (), announce: Callable[[str], None] = lambda text: None
    ) -> list[RunEntry]:
        """Runs as they are now, the newest first, with these metrics (None: all that they have).

        `announce` gets a line when many folders are to be read. Raises UnusableInputError for no folder.
        """

        def listed(connection: sqlite3.Connection) -> list[RunEntry]:
            self._update(connection, announce)
            values = _metrics(connection, metrics)
            rows = connection.execute("SELECT path, entry FROM run ORDER BY began_s DESC, path DESC")
            return [_entry(text, values.get(path, {})) for path, text in rows]

        return self._asked(listed)

    def metric_names(self) -> list[str]:
        """The metrics that any run has."""
        names = "SELECT DISTINCT name FROM metric ORDER BY name"
        return self._asked(lambda connection: [name for (name,) in connection.execute(names)])

    def _update(self, connection: sqlite3.Connection, announce: Callable[[str], None]) -> None:
        known = dict(connection.execute("SELECT path, stamp FROM run"))
        found = dict(_run_folders(self.base, known))
        changed = [path for path, stamp in found.items() if known.get(path) != stamp]
        removed = known.keys() - found.keys()
        if not changed and not removed:
            return
        if len(changed) >= _MANY:
            announce(f"{self.base}: reading {len(changed)} runs into the index")
        entries = [read_entry(self.base, path) for path in changed]
        self.opened += len(changed)
        with connection:
            connection.executemany("DELETE FROM run WHERE path = ?", [(path,) for path in [*removed, *changed]])
            if known:
                connection.executemany("DELETE FROM metric WHERE path = ?", [(path,) for path in [*removed, *changed]])
            connection.executemany(
                "INSERT OR REPLACE INTO run VALUES (?, ?, ?, ?)",
                [
                    (each.path, found[each.path], each.began_s, each.model_dump_json(exclude={"metrics"}))
                    for each in entries
                ],
            )
            connection.executemany(
                "INSERT OR REPLACE INTO metric VALUES (?, ?, ?)",
                [(name, each.path, value) for each in entries for name, value in each.metrics.items()],
            )

    def _asked(self, question: Callable[[sqlite3.Connection], list[_Answer]]) -> list[_Answer]:
        """Query the file, which is made anew where it is damaged, of another version or no index at all; or one in
        memory where it can't be written, or somebody else holds it."""
        for _ in range(2):
            try:
                with closing(_opened(self.base / FILE)) as file:
                    return question(file)
            except sqlite3.DatabaseError as error:
                if getattr(error, "sqlite_errorcode", 0) & 0xFF in _OF_ANOTHER:
                    break
                for suffix in ("", "-wal", "-shm"):
                    with suppress(OSError):
                        os.unlink(self.base / f"{FILE}{suffix}")
        with closing(_opened(":memory:")) as memory:
            self._update(memory, lambda text: None)
            return question(memory)


def _opened(path: str | Path) -> sqlite3.Connection:
    return connected(path, _TABLES, _VERSION, _PATIENCE_S, _drop_tables)


def _drop_tables(connection: sqlite3.Connection, version: int) -> None:
    for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall():
        connection.execute(f'DROP TABLE "{name}"')


def _entry(text: str, metrics: Mapping[str, float]) -> RunEntry:
    try:
        return RunEntry.model_validate_json(text).model_copy(update={"metrics": metrics})
    except ValueError as error:
        raise sqlite3.DatabaseError("a row of the index is damaged") from error


def _metrics(connection: sqlite3.Connection, names: Iterable[str] | None) -> dict[str, dict[str, float]]:
    """Metrics by run, then by name."""
    values: dict[str, dict[str, float]] = {}
    if names is None:
        rows = connection.execute("SELECT name, path, value FROM metric").fetchall()
    else:
        rows = [row for name in {*names} for row in connection.execute("SELECT * FROM metric WHERE name = ?", (name,))]
    for name, path, value in rows:
        values.setdefault(path, {})[name] = value
    return values


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
