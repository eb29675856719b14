"""Recordings of other machines: which of their columns is which channel, by a mapping file (YAML).

::

    file: {delimiter: ";", decimal: ","}     # CSV only; also skip_rows, encoding
    channels:
      t_s: {column: "Zeit [ms]", factor: 0.001}
      v2_m_s: {column: Bahngeschwindigkeit, factor: 0.01666667}
      tau2_Nm: M2                            # as it is

Rows of units behind the header are left out; dates (ISO 8601) and times of day become seconds after the first one.
"""

from __future__ import annotations

import re
import warnings
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from hilbench import strict_yaml
from hilbench.block import Block
from hilbench.did_you_mean import did_you_mean, expected_one_of
from hilbench.errors import UnusableInputError, one_line
from hilbench.files import require_file
from hilbench.results.recording import Recording, check_recording, read_recording
from hilbench.results.text_table import MOST_COLUMNS, open_text, rest_of_text
from hilbench.topology.signal_kinds import TIME
from hilbench.topology.signals import example_names, find_signal, unit_of

_NUMBER_OR_DATE = re.compile(r"[-+]?[.,]?\d|[-+]?(nan|inf)", re.IGNORECASE)
_TIME_OF_DAY = re.compile(r"\d+:\d\d:\d\d")
_CSV = (".csv", ".txt", ".tsv", ".gz")


class TextFile(Block):
    """Format of the text file."""

    delimiter: str = ","
    decimal: str = Field(default=".", min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0, description="lines before the header row")
    encoding: str = "utf-8-sig"


class Column(Block):
    """Source of a channel: value = factor · column + offset, in the channel's SI unit."""

    column: str
    factor: float = 1.0
    offset: float = 0.0


class ColumnMapping(Block):
    """The mapping file."""

    file: TextFile = TextFile()
    channels: dict[str, Column]

    @field_validator("channels", mode="before")
    @classmethod
    def _plain_names(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {name: {"column": entry} if isinstance(entry, str) else entry for name, entry in value.items()}

    @field_validator("channels")
    @classmethod
    def _channels_of_ours(cls, value: dict[str, Column]) -> dict[str, Column]:
        if TIME not in value:
            raise ValueError(f"a column for {TIME}")
        for name in value:
            if find_signal(name) is None and not unit_of(name):
                meant = did_you_mean(name, example_names())
                raise ValueError(
                    f"channels of the signal list, or names that end in an SI unit; '{name}' does not{meant}"
                )
        return value


def read_foreign(path: Path, mapping_path: Path, report: Callable[[str], None] = lambda text: None) -> Recording:
    """Read a recording of another machine; `report` gets the columns that the mapping leaves out.

    Raises UnusableInputError: file, what was found, what was expected.
    """
    mapping = strict_yaml.validate(strict_yaml.load(mapping_path), ColumnMapping)
    columns = _columns(path, mapping.file, report)
    channels = {}
    for name, source in sorted(mapping.channels.items(), key=lambda item: item[0] != TIME):
        if source.column not in columns:
            expected = expected_one_of(source.column, columns)
            raise UnusableInputError(path, f"no column '{source.column}' for {name}{expected}")
        values = columns[source.column]
        if isinstance(values, str):
            raise UnusableInputError(
                path, f"column '{source.column}' for {name} has '{values}', expected numbers, or times by ISO 8601"
            )
        channels[name] = source.factor * values + source.offset
    left_out = [name for name in columns if name not in {source.column for source in mapping.channels.values()}]
    if left_out:
        report(f"columns that {mapping_path} does not name: {', '.join(left_out)}")
    recording = Recording(channels, comment=f"from {path.name}")
    check_recording(recording, path)
    return recording


def _columns(path: Path, file: TextFile, report: Callable[[str], None]) -> dict[str, NDArray[np.float64] | str]:
    """Values by column; of one that has neither numbers nor times a text of it."""
    if path.suffix.lower() not in _CSV:
        recording = read_recording(path)
        return {name: np.asarray(values, np.float64) for name, values in recording.channels.items()}
    import pandas

    require_file(path)
    try:
        with open_text(path, file.encoding) as text:
            header = next(islice(text, file.skip_rows, None), "")
            units = dict(enumerate(takewhile(partial(_is_row_of_units, file=file), text), file.skip_rows + 1))
        for row, line in units.items():
            report(f"line {row + 1} of {path} is no row of numbers, and taken as one of units: {line.strip()}")
        if header.count(file.delimiter) >= MOST_COLUMNS:
            raise UnusableInputError(path, f"more than {MOST_COLUMNS} columns, expected no more")
        with warnings.catch_warnings(), open_text(path, file.encoding) as text:
            warnings.simplefilter("ignore")
            table = pandas.read_csv(
                rest_of_text(path, text),
                sep=file.delimiter,
                decimal=file.decimal,
                skiprows=[*range(file.skip_rows), *units],
            )
    except (OSError, EOFError, zlib.error, ValueError, LookupError) as error:  # pandas' parser errors are ValueErrors
        raise UnusableInputError(path, f"cannot be read as a table ({one_line(error)})") from error
    columns: dict[str, NDArray[np.float64] | str] = {}
    for name in table.columns:
        try:
            found: NDArray[np.float64] | str = table[name].to_numpy(np.float64)
        except ValueError:
            texts = [str(text) for text in table[name]]
            found = next((text for text in texts if not _NUMBER_OR_DATE.match(text)), texts[0])
            dates = partial(pandas.to_datetime, format="ISO8601", utc=True)
            read: Callable[[Any], Any] = pandas.to_timedelta if _TIME_OF_DAY.match(texts[0]) else dates
            with suppress(ValueError, TypeError):  # other text: no channel
                times = read(table[name])
                found = ((times - times.iloc[0]) / pandas.Timedelta("1s")).to_numpy(np.float64)
        columns[str(name).strip()] = found
    return columns


def _is_row_of_units(line: str, file: TextFile) -> bool:
    """True if the first line behind the header has words, and neither a number nor a date."""
    cells = [cell.strip().strip('"') for cell in line.split(file.delimiter)]
    return any(cells) and not any(_NUMBER_OR_DATE.match(cell) for cell in cells)
