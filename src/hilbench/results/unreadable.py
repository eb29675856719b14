"""Message about a file that is no recording, and the most that a recording may unpack to."""

from __future__ import annotations

from pathlib import Path

from hilbench.errors import UnusableInputError, one_line

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
