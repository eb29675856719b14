"""``journal.log``: what the bench did and no frame says, one JSON object per line, written as it happens."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Self

from pydantic import TypeAdapter, ValidationError

from hilbench.bench.reports.change import Change
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.files import require_file, usable

_CHANGE = TypeAdapter(Change)
_ENCODER = json.JSONEncoder(separators=(",", ":"))
_LONGEST_LINE = 512

_EXPECTED = "a run's journal"


class JournalWriter:
    """Hands each change to the operating system at once, so that it survives the end of the process (``kill -9``).

    `path` must not exist yet. Raises UnusableInputError if it cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with usable(path, "created", "a new file in a writable folder"):
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o666)

    def write(self, change: Change) -> None:
        """Add one change. Raises BenchFaultError (disk full, …)."""
        line = _line(change)
        try:
            written = os.write(self._file, line)
        except OSError as error:
            raise BenchFaultError(f"{self.path}: the journal cannot be written ({error.strerror})") from error
        if written != len(line):
            raise BenchFaultError(f"{self.path}: the journal cannot be written (no space left)")

    def close(self) -> None:
        """Close the file. Calling it twice is no error."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class JournalReader:
    """Reads a journal while it is written. Raises UnusableInputError as `read_journal`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._offset, self._lines, self._rest = 0, 0, b""

    def new(self) -> list[Change]:
        """The changes since the last call, as far as their lines are whole."""
        require_file(self.path)
        with usable(self.path, "read", _EXPECTED), open(self.path, "rb") as file:
            file.seek(self._offset)
            text = file.read()
        self._offset += len(text)
        *whole, self._rest = (self._rest + text).split(b"\n")
        self._lines += len(whole)
        first = self._lines - len(whole) + 1
        if len(self._rest) > _LONGEST_LINE:  # no line that is being written
            whole.append(self._rest)
        return [_change(line, f"{self.path}:{number}") for number, line in enumerate(whole, first)]


def append_to_journal(path: Path, change: Change) -> None:
    """Add what somebody else than the bench did to the journal of a run. Raises UnusableInputError."""
    line = _line(change)
    with usable(path, "written", _EXPECTED):
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
        try:
            os.write(file, line)
        finally:
            os.close(file)


def read_journal(path: Path) -> list[Change]:
    """Read all changes in their order; a last line that a crash cut off is left out.

    Raises UnusableInputError with file and line on anything that is no change.
    """
    return JournalReader(path).new()


def _line(change: Change) -> bytes:
    fields = {name: value for name, value in vars(change).items() if name != "who" or value is not None}
    return (_ENCODER.encode(fields) + "\n").encode()


def _change(line: bytes, place: str) -> Change:
    try:
        return _CHANGE.validate_json(line)
    except ValidationError:
        found = line[:60].decode("latin-1").strip()
        raise UnusableInputError(place, f"'{found}', expected a change of the bench as one JSON object") from None
