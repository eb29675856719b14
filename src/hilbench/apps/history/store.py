"""The history of stands: one SQLite file with what each run has found of the machine.

Several runs may add at a time: each waits for the lock, and adds in one transaction; whoever is killed while writing
leaves the file whole. `entries.rebuild` makes it again from run folders.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from hilbench.errors import UnusableInputError
from hilbench.files import make_folder
from hilbench.topology.config import BenchConfig

#: How long a run waits for another one that writes, s.
_PATIENCE_S: Final = 10.0
_VERSION: Final = 1
#: Where the history lies unless the config says so: beside the folder of the runs.
FILE: Final = "history.sqlite"
#: The source of what a commissioning has measured.
COMMISSIONING: Final = "commissioning"
_TABLES: Final = """
CREATE TABLE run (
    id INTEGER PRIMARY KEY,
    stand TEXT NOT NULL,
    run TEXT NOT NULL,
    source TEXT NOT NULL,
    time_s REAL NOT NULL,
    folder TEXT NOT NULL,
    UNIQUE (stand, run, source)
) STRICT;
CREATE TABLE found (
    run INTEGER NOT NULL REFERENCES run (id) ON DELETE CASCADE,
    quantity TEXT NOT NULL,
    value REAL NOT NULL,
    sd REAL NOT NULL CHECK (sd >= 0),
    unit TEXT NOT NULL,
    tied_with TEXT NOT NULL,
    PRIMARY KEY (run, quantity)
) STRICT, WITHOUT ROWID;
"""


@dataclass(frozen=True)
class Quantity:
    """A quantity that was estimated: its name (``axis2.coulomb_friction.force_N``), value and stated standard
    deviation in `unit`; `tied_with`: the effects that these data could not distinguish from it, comma-separated."""

    name: str
    value: float
    sd: float
    unit: str
    tied_with: str = ""


@dataclass(frozen=True)
class Entry:
    """Findings of one run. `source`: ``twin``, ``diagnosis`` or ``commissioning``; `run`: name of the run folder."""

    stand: str
    run: str
    source: str
    time: datetime  #: when the run began, with its time zone
    folder: Path
    quantities: Sequence[Quantity]


@dataclass(frozen=True)
class Row:
    """A quantity as one run has found it. `time_s`: since 1970, UTC."""

    run: str
    source: str
    time_s: float
    quantity: Quantity


def history_of(config: BenchConfig, runs: Path) -> Path:
    """The history file of a bench whose run folders are made in `runs`."""
    return config.history or history_beside(runs)


def history_beside(runs: Path) -> Path:
    """The history file of run folders in `runs` whose config names no other."""
    return runs.resolve().parent / FILE


class History:
    """A history file, which is made where there is none. Raises UnusableInputError, one line, for what is none."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def add(self, *entries: Entry) -> None:
        """Add runs, all or none of them; what a run has found before from the same source is replaced."""
        with self._connected(make=True) as connection, connection:
            for entry in entries:
                _write(connection, entry)

    def replace_all(self, stand: str | None, entries: Sequence[Entry]) -> None:
        """Replace the history, or that of one stand, by these runs alone."""
        with self._connected(make=True) as connection, connection:
            connection.execute("DELETE FROM run WHERE ?1 IS NULL OR stand = ?1", (stand,))
            for entry in entries:
                _write(connection, entry)

    def stands(self) -> list[str]:
        """Names of the stands, in order."""
        with self._connected() as connection:
            return [name for (name,) in connection.execute("SELECT DISTINCT stand FROM run ORDER BY stand")]

    def rows(self, stand: str) -> list[Row]:
        """Findings of a stand, by quantity and time."""
        with self._connected() as connection:
            found = connection.execute(
                "SELECT run.run, source, time_s, quantity, value, sd, unit, tied_with"
                " FROM found JOIN run ON run.id = found.run WHERE stand = ? ORDER BY quantity, time_s, run.run, source",
                (stand,),
            )
            return [Row(run, source, time_s, Quantity(*quantity)) for run, source, time_s, *quantity in found]

    @contextmanager
    def _connected(self, *, make: bool = False) -> Iterator[sqlite3.Connection]:
        if not make and not self.path.is_file():
            raise UnusableInputError(self.path, "no such file, expected the history of a stand (runs make it)")
        make_folder(self.path.parent)
        try:
            with closing(sqlite3.connect(self.path, timeout=_PATIENCE_S, isolation_level="IMMEDIATE")) as connection:
                connection.execute("PRAGMA foreign_keys = ON")
                if _version_of(connection) != _VERSION:
                    self._make_tables(connection)
                yield connection
        except sqlite3.OperationalError as error:
            raise UnusableInputError(self.path, f"cannot be used ({error}), expected a history of stands") from error
        except sqlite3.DatabaseError as error:
            raise UnusableInputError(self.path, f"is no history of stands ({error})") from error

    def _make_tables(self, connection: sqlite3.Connection) -> None:
        with connection:
            connection.execute("BEGIN IMMEDIATE")
            version = _version_of(connection)
            if version == _VERSION:  # another process was faster
                return
            if version:
                raise UnusableInputError(
                    self.path,
                    f"is of version {version}, expected {_VERSION}: remove it, and hilbench history --rebuild",
                )
            if connection.execute("SELECT count(*) FROM sqlite_schema").fetchone() != (0,):
                raise UnusableInputError(self.path, "has tables of something else, expected a history of stands")
            for statement in filter(str.strip, _TABLES.split(";")):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {_VERSION}")


def _version_of(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _write(connection: sqlite3.Connection, entry: Entry) -> None:
    key = (entry.stand, entry.run, entry.source)
    connection.execute("DELETE FROM run WHERE stand = ? AND run = ? AND source = ?", key)
    cursor = connection.execute(
        "INSERT INTO run (stand, run, source, time_s, folder) VALUES (?, ?, ?, ?, ?)",
        (*key, entry.time.astimezone(UTC).timestamp(), str(entry.folder)),
    )
    connection.executemany(
        "INSERT INTO found VALUES (?, ?, ?, ?, ?, ?)",
        [(cursor.lastrowid, each.name, each.value, each.sd, each.unit, each.tied_with) for each in entry.quantities],
    )
