"""Files that are read up to a size, or written for a person: an error (no space, no right) is one line."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hilbench.errors import UnusableInputError


def content(path: str | Path, most_bytes: int, *, kept: bool = False) -> bytes:
    """Content of a whole file. Raises OSError where it can't be read, UnusableInputError where it is larger.

    `kept`: in a folder in which only regular files count: a pipe, say, which would block, is refused.
    """
    if kept and not stat.S_ISREG(os.stat(path).st_mode):
        raise UnusableInputError(path, "is no file, expected one")
    with open(path, "rb") as file:
        found = file.read(most_bytes + 1)
    if len(found) > most_bytes:
        raise UnusableInputError(path, f"larger than {most_bytes / 1e6:g} MB, expected a file of at most that size")
    return found


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Write a file inside. Raises UnusableInputError when it cannot be written."""
    try:
        yield
    except OSError as error:
        raise _unwritable(error.filename or path, error) from error


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """The file to write in place of `path`, which appears complete or not at all. Raises UnusableInputError."""
    partial = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        try:
            yield partial
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from error


def make_folder(path: Path) -> None:
    """Make a folder, with those above it, where there is none. Raises UnusableInputError when it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableInputError(path, f"cannot be made ({error.strerror}), expected a folder") from error


def _unwritable(path: str | Path, error: OSError) -> UnusableInputError:
    return UnusableInputError(path, f"cannot be written ({error.strerror}), expected a writable folder")
