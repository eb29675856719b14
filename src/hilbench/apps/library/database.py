"""SQLite files that several processes use at a time: the index of a folder of runs, and the history of stands.

A write-ahead log, a waiting time for the lock, and one transaction a change: whoever is killed while writing leaves the
file whole.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

_RETRY_S: Final = 0.005


def connected(
    path: str | Path, tables: str, version: int, patience_s: float, replace: Callable[[sqlite3.Connection, int], None]
) -> sqlite3.Connection:
    """Open a file of this version, made with these `tables` where there is none; to be closed.

    `replace` gets the connection and the version of a file that has other tables: it drops them, or raises. Raises
    sqlite3.Error.
    """
    connection = sqlite3.connect(path, timeout=patience_s, isolation_level="IMMEDIATE")
    try:
        connection.execute("PRAGMA foreign_keys = ON")
        if _version(connection) != version:
            _write_ahead(connection, patience_s)
            with connection:
                connection.execute("BEGIN IMMEDIATE")
                found = _version(connection)
                if found != version:  # no other process was faster
                    if connection.execute("SELECT count(*) FROM sqlite_schema").fetchone() != (0,):
                        replace(connection, found)
                    for statement in filter(str.strip, tables.split(";")):
                        connection.execute(statement)
                    connection.execute(f"PRAGMA user_version = {version}")
    except BaseException:
        connection.close()
        raise
    return connection


def _write_ahead(connection: sqlite3.Connection, patience_s: float) -> None:
    """Give a file its write-ahead log. SQLite itself does not wait for the lock of that: of several processes that make
    the file at a time each but one would fail."""
    end_s = time.monotonic() + patience_s
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > end_s:
                raise
            time.sleep(_RETRY_S)


def _version(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])
