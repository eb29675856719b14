"""Tables as text: a header row of names, then rows of numbers separated by commas; `.gz` is unpacked.

Also messages about files that are no recording, and the most that a recording may unpack to.
"""

from __future__ import annotations

import gzip
import io
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from hilbench.errors import UnusableInputError, one_line

#: Columns of a table, characters of the row that names them, and of all below it, at most.
MOST_COLUMNS, _LONGEST_HEADER, _MOST_CHARACTERS = 4096, 500_000, 500_000_000


def read_table(path: Path) -> tuple[list[str], NDArray[np.float64]]:
    """Names and rows (samples, names) of a CSV file. Raises UnusableInputError."""
    try:
        with open_text(path) as file:
            names = _header(path, file.readline(_LONGEST_HEADER))
            return names, _rows(path, file, len(names))
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.strerror:
            reason = error.strerror
        else:
            reason = "not UTF-8 text" if isinstance(error, UnicodeDecodeError) else short_reason(error)
        raise UnusableInputError(path, f"cannot be read ({reason}), {EXPECTED_FORMATS}") from error


def open_text(path: Path, encoding: str = "utf-8-sig") -> IO[str]:
    """A table as text, unpacked if it is packed."""
    if path.suffix.lower() == ".gz":
        return gzip.open(path, "rt", encoding=encoding, newline=None)
    return open(path, encoding=encoding)


def rest_of_text(path: Path, file: IO[str]) -> io.StringIO:
    """Rest of a table as text. Raises UnusableInputError where it is more than can be read."""
    text = file.read(_MOST_CHARACTERS + 1)
    if len(text) > _MOST_CHARACTERS:
        raise UnusableInputError(
            path, f"more than {_MOST_CHARACTERS / 1e6:g} MB of text, expected fewer, or the same as MDF or Parquet"
        )
    return io.StringIO(text)


def _header(path: Path, line: str) -> list[str]:
    names = [name.strip().strip('"') for name in line.rstrip("\n").split(",")]
    place = f"{path}:1"
    if len(names) > MOST_COLUMNS:
        raise UnusableInputError(place, f"more than {MOST_COLUMNS} columns, expected no more")
    if any(not name or name[0].isdigit() or name[0] in "-+." for name in names):
        raise UnusableInputError(place, f"'{line.strip()[:60]}', expected a row of channel names separated by commas")
    for position, name in enumerate(names):
        if name in names[:position]:
            raise UnusableInputError(place, f"channel {name} is there twice, expected once")
    return names


def _rows(path: Path, file: IO[str], width: int) -> NDArray[np.float64]:
    """The numbers below the header, shape (samples, width)."""
    lines = rest_of_text(path, file).readlines()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "no data": said better by the check of the time
            rows = np.loadtxt(lines, delimiter=",", ndmin=2, comments=None)
    except ValueError as error:
        otherwise = path, "not readable as numbers, expected a table separated by commas"
        raise UnusableInputError(*next(_problems(path, lines, width), otherwise)) from error
    if not rows.size:
        return np.empty((0, width))
    if rows.shape[1] != width:
        raise UnusableInputError(f"{path}:2", f"{rows.shape[1]} values, expected {width} as in the header")
    return np.asarray(rows, np.float64)


def _problems(path: Path, lines: Sequence[str], width: int) -> Iterator[tuple[str | Path, str]]:
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        fields = line.rstrip("\n").split(",")
        if len(fields) != width:
            yield f"{path}:{number}", f"{len(fields)} values, expected {width} as in the header"
        for position, text in enumerate(fields):
            try:
                float(text)
            except ValueError:
                yield f"{path}:{number}", f"value {position + 1} is '{text.strip()[:40]}', expected a number"


#: Formats that are read and written.
EXPECTED_FORMATS = "expected a recording: .mf4, .csv, .csv.gz or .parquet"
#: Values of all channels that are unpacked from MDF or Parquet, at most: 8 GB of values, which 40 channels at 500 Hz
#: fill in 13 hours.
_MOST_VALUES = 1_000_000_000


def check_unpacked(values: int, path: Path) -> None:
    """Raise UnusableInputError where all channels together have more values than are unpacked."""
    if values > _MOST_VALUES:
        raise UnusableInputError(
            path, f"{values / 1e6:.0f} million values when unpacked, expected at most {_MOST_VALUES / 1e6:.0f} million"
        )


def short_reason(error: BaseException) -> str:
    """Reason of a library's error, on one line, 200 characters at most."""
    return one_line(error)[:200]
