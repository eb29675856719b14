"""Files that are read up to a size, or written for a person: an error (no space, no right) is one line."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from hilbench.errors import UnusableInputError


def content(path: str | Path, most_bytes: int, *, kept: bool = False) -> bytes:
    """Content of a whole file. Raises OSError where it can't be read, UnusableInputError where it is larger.

    `kept`: in a folder in which only regular files count: a pipe, say, which would block, is refused.
    """
    if kept:
        require_file(path)
    with open(path, "rb") as file:
        found = file.read(most_bytes + 1)
    if len(found) > most_bytes:
        raise UnusableInputError(path, f"larger than {most_bytes / 1e6:g} MB, expected a file of at most that size")
    return found


def require_file(path: str | Path) -> None:
    """Raise UnusableInputError for what is there and no file: a pipe that nobody writes to would be waited for."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise UnusableInputError(path, "is no file, expected one")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """The file to write in place of `path`, which appears complete or not at all, whatever ends the process.

    Behind a link it is the file that the link is to; what is no file (/dev/stdout, a pipe) is written as it is. Raises
    UnusableInputError.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        with _writable(path):
            yield path
        return
    partial = target.with_name(f".{os.getpid()}.{target.name}")
    with _writable(path):
        try:
            yield partial
            if target.exists():
                shutil.copymode(target, partial)
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)


def write_whole(path: str | Path, text: str) -> None:
    """Write a text (UTF-8; a name in it that is none with question marks), as `written_whole`."""
    with written_whole(Path(path)) as partial:
        partial.write_text(text, encoding="utf-8", errors="replace")


def make_folder(path: Path) -> None:
    """Make a folder, with those above it, where there is none. Raises UnusableInputError when it cannot be made."""
    with usable(path, "made", "a folder"):
        path.mkdir(parents=True, exist_ok=True)


@contextmanager
def usable(path: str | Path, use: str, expected: str) -> Iterator[None]:
    """Raise UnusableInputError where a file can't be `use` (read, written) as `expected`, for what the system says."""
    try:
        yield
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UnusableInputError(path, f"cannot be {use} ({reason}), expected {expected}") from error


def _writable(path: Path) -> AbstractContextManager[None]:
    return usable(path, "written", "a writable folder")
