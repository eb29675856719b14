"""Files that are written for a person: what goes wrong (no space, no such folder, no right) is one line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hilbench.errors import UnusableInputError


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Meanwhile a file is written. Raises UnusableInputError when it cannot be."""
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
