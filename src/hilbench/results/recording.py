"""A recording: channels with one time base, as MDF4 (``.mf4``), CSV (``.csv``, ``.csv.gz``, a header row) or Parquet.

Channel names, units and descriptions are those of `hilbench.topology.signals`; a channel that is not in that list is
kept, its unit read from its name's suffix. Numbers survive every format exactly (CSV uses the shortest text that
reads back as the same binary64 number). What is too long for memory is read reduced (`hilbench.results.reduction`), or
a section of it.
"""

from __future__ import annotations

import gzip
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from math import inf
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from hilbench.did_you_mean import did_you_mean
from hilbench.errors import UnusableInputError
from hilbench.files import require_file, written_whole
from hilbench.results.foreign_mdf import read_mdf
from hilbench.results.journal import read_journal
from hilbench.results.mdf import Column, MdfPieces, MdfWriter, is_ours
from hilbench.results.reduction import GAP_S, MOST_VALUES, joined, reduced
from hilbench.results.text_table import EXPECTED_FORMATS, check_unpacked, read_table, short_reason
from hilbench.runs.events import Event, journal_events
from hilbench.topology.signal_kinds import TIME
from hilbench.topology.signals import find_signal, unit_of

#: Start time written into an MDF4 file when none is given, so that equal samples make equal files.
NO_START_TIME = datetime(2000, 1, 1, tzinfo=UTC)

#: Samples from which on there is something to draw or to evaluate; a run that ended earlier leaves no recording.
LEAST_SAMPLES = 2

#: Samples of a piece of a recording.
BLOCK_ROWS = 8192


@dataclass(frozen=True)
class Recording:
    """Named one-dimensional arrays over one strictly increasing time base.

    `channels` holds the time channel ``t_s`` (s) too, always first. `start_time` is when the run began, if known;
    `comment` is free text.
    """

    channels: Mapping[str, NDArray[Any]]
    start_time: datetime | None = None
    comment: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    recorded: int | None = None  #: samples of the whole file, where it is known; fewer are here of a long one

    @property
    def samples(self) -> int:
        """Samples of the whole recording."""
        return len(self) if self.recorded is None else self.recorded

    @property
    def is_reduced(self) -> bool:
        """True if it does not have all samples of its file."""
        return len(self) < self.samples

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.channels[name]

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.channels[TIME])

    @property
    def time_s(self) -> NDArray[np.float64]:
        """The time base, shape (samples,), s."""
        return np.asarray(self.channels[TIME], np.float64)

    def unit(self, name: str) -> str:
        """Unit of a channel, "" for a pure number."""
        return self.units.get(name) or unit_of(name)

    def to_pandas(self) -> Any:
        """The channels as a pandas DataFrame over ``t_s``; their units stand in its ``attrs["units"]``."""
        import pandas

        frame = pandas.DataFrame({name: values for name, values in self.channels.items() if name != TIME})
        frame.index = pandas.Index(self.time_s, name=TIME)
        frame.attrs["units"] = {name: self.unit(name) for name in self.channels}
        return frame

    def to_xarray(self) -> Any:
        """The channels as an xarray Dataset over ``t_s``; units stand where plots look for them, in ``attrs["units"]``.

        Needs xarray: ``pip install hilbench[xarray]``.
        """
        import xarray

        channels = {
            name: (TIME, values, {"units": self.unit(name)}) for name, values in self.channels.items() if name != TIME
        }
        time = {TIME: (TIME, self.time_s, {"units": self.unit(TIME)})}
        return xarray.Dataset(channels, time, {"description": self.comment})

    def require(self, names: Sequence[str], place: str | Path) -> None:
        """Raise UnusableInputError, naming `place`, unless all these channels are there and finite everywhere."""
        missing = [name for name in names if name not in self.channels]
        if missing:
            meant = did_you_mean(missing[0], [name for name in self.channels if find_signal(name) is None])
            raise UnusableInputError(
                place, f"channel {', '.join(missing)} missing{meant or ','} expected beside {', '.join(self.channels)}"
            )
        for name in names:
            finite = np.isfinite(np.asarray(self.channels[name], np.float64))
            if not finite.all():
                count, first = int((~finite).sum()), int(np.argmin(finite))
                raise UnusableInputError(
                    place,
                    f"channel {name} has {count} value(s) that are no finite number, the first in sample {first + 1}"
                    f" (t = {self.time_s[first]:g} s), expected none",
                )


def typed(name: str, values: NDArray[np.float64]) -> NDArray[Any]:
    """Counts and bit fields as integers, where every sample is one."""
    signal = find_signal(name)
    if signal is not None and signal.integer and np.isfinite(values).all():
        integers = values.astype(np.int64)
        if (integers == values).all() and (integers >= 0).all() and (integers < 2**32).all():
            return integers.astype(np.uint32)
    return values


# -- writing ---------------------------------------------------------------------------------------------------------


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording in the format that the file name asks for; the file appears complete or not at all.

    Equal recordings give equal files, byte for byte, with the same versions of the libraries.
    Raises UnusableInputError for another suffix or a file that cannot be written.
    """
    path = Path(path)
    kind = _kind(path)
    with written_whole(path) as unfinished:
        _WRITERS[kind](_Source.of(recording), unfinished)


@dataclass(frozen=True)
class _Source:
    """Source of a file: what it is of, and its samples, piece by piece."""

    columns: Sequence[Column]
    start_time: datetime | None
    comment: str
    pieces: Iterable[Mapping[str, NDArray[Any]]]
    thinned: bool = False

    @classmethod
    def of(cls, recording: Recording) -> Self:
        """A recording that is in memory."""
        channels = {name: _storable(values) for name, values in recording.channels.items()}
        columns = [column_of(name, values.dtype, recording.unit(name)) for name, values in channels.items()]
        columns.sort(key=lambda column: column.name != TIME)
        pieces = (
            {name: values[at : at + BLOCK_ROWS] for name, values in channels.items()}
            for at in range(0, len(recording), BLOCK_ROWS)
        )
        return cls(columns, recording.start_time, recording.comment, pieces)


def column_of(name: str, dtype: np.dtype[Any], unit: str = "") -> Column:
    """A channel as a file has it: what is known of its signal beside its name."""
    signal = find_signal(name)
    meaning, group = ("", "other") if signal is None else (signal.description, signal.group)
    return Column(name, dtype, unit or unit_of(name), meaning, group)


def _storable(values: NDArray[Any]) -> NDArray[Any]:
    """Numbers of a kind that every format has."""
    data = np.asarray(values)
    stored = data.dtype.kind in "iu" or (data.dtype.kind == "f" and data.dtype.itemsize in (4, 8))
    return data if stored else data.astype(np.float64)


def convert_recording(source: Path, target: Path) -> tuple[int, list[str]]:
    """Write a recording in another format, piece by piece where hilbench has written it; samples and channels' names.

    Raises UnusableInputError as `read_recording` and `write_recording`.
    """
    if not _is_in_pieces(source):
        recording = read_recording(source)
        write_recording(recording, target)
        return len(recording), list(recording.channels)
    pieces = MdfPieces(source)
    _check_count(pieces.rows, source)
    write_pieces(pieces, pieces, target)
    return pieces.rows, [column.name for column in pieces.columns]


def write_pieces(of: MdfPieces, pieces: Iterable[Mapping[str, NDArray[Any]]], target: Path) -> None:
    """Write samples, piece by piece, of a recording like another one. Raises as `write_recording`."""
    kind, start = _kind(target), None if of.start == NO_START_TIME else of.start
    with written_whole(target) as unfinished:
        _WRITERS[kind](_Source(of.columns, start, of.comment, pieces, of.thinned), unfinished)


def _write_mdf(source: _Source, path: Path) -> None:
    start = source.start_time or NO_START_TIME
    with closing(MdfWriter(path, source.columns, start, source.comment, thinned=source.thinned)) as writer:
        for piece in source.pieces:
            writer.append(piece)


def _write_csv(source: _Source, path: Path) -> None:
    names = [column.name for column in source.columns]

    def lines(file: IO[bytes]) -> None:
        file.write((",".join(names) + "\n").encode())
        for piece in source.pieces:
            for row in zip(*(piece[name].tolist() for name in names), strict=True):
                file.write((",".join(map(repr, row)) + "\n").encode())

    with open(path, "wb") as raw:
        if path.suffix == ".gz":
            with gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=0, compresslevel=6) as packed:
                lines(packed)  # type: ignore[arg-type]
        else:
            lines(raw)


def _write_parquet(source: _Source, path: Path) -> None:
    pyarrow, parquet = _pyarrow(path)
    fields = [
        pyarrow.field(column.name, pyarrow.from_numpy_dtype(column.dtype), metadata={"unit": column.unit})
        for column in source.columns
    ]
    about = {"comment": source.comment}
    if source.start_time is not None:
        about["start_time"] = source.start_time.isoformat()
    schema = pyarrow.schema(fields, metadata=about)
    with open(path, "wb") as file, parquet.ParquetWriter(file, schema, compression="zstd") as writer:
        for piece in source.pieces:
            writer.write_table(pyarrow.Table.from_arrays([pyarrow.array(piece[f.name]) for f in fields], schema=schema))


def _pyarrow(path: Path) -> tuple[Any, Any]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise UnusableInputError(path, "Parquet needs pyarrow, expected hilbench[parquet] to be installed") from error
    return pyarrow, parquet


_WRITERS = {".mf4": _write_mdf, ".csv": _write_csv, ".csv.gz": _write_csv, ".parquet": _write_parquet}


# -- reading ---------------------------------------------------------------------------------------------------------


def read_rows(path: Path) -> Recording:
    """Read a recording as it is: its time may be missing, out of order, repeated or no number.

    For who cleans rows before using them (`hilbench.diagnosis.data_cleaning`). Raises UnusableInputError, one line,
    for what is no table of numbers.
    """
    path = Path(path)
    kind = _kind(path)
    require_file(path)
    return _READERS[kind](path)


def read_section(path: Path, around_s: float = -inf) -> Recording:
    """Read a recording as `read_rows`, for whoever needs one sample after the other.

    Of one that is too long for memory come the samples around a time (s; -inf: the first, inf: the last ones); of one
    that has full rate around events only its longest stretch of full rate.
    """
    path = Path(path)
    return section_of(MdfPieces(path), around_s) if _is_in_pieces(path) else read_rows(path)


def section_of(pieces: MdfPieces, around_s: float) -> Recording:
    """Section of a recording in pieces, as `read_section`."""
    if pieces.rows * len(pieces.columns) <= MOST_VALUES:
        return _at_full_rate(_of_pieces(pieces, pieces), pieces)
    most = MOST_VALUES // len(pieces.columns)
    kept: deque[Mapping[str, NDArray[Any]]] = deque()
    rows = behind = 0
    for piece in pieces:
        kept.append(piece)
        rows += len(piece[TIME])
        behind += len(piece[TIME]) if piece[TIME][0] > around_s else 0
        while rows - len(kept[0][TIME]) >= most:
            rows -= len(kept.popleft()[TIME])
        if behind >= most // 2 and rows > most - BLOCK_ROWS:
            break
    return _at_full_rate(_of_pieces(pieces, kept), pieces)


def _at_full_rate(recording: Recording, pieces: MdfPieces) -> Recording:
    """The longest stretch without a gap."""
    if not pieces.thinned or len(recording) < LEAST_SAMPLES:
        return recording
    gaps = np.flatnonzero(np.diff(recording.time_s) > GAP_S) + 1
    edges = np.concatenate([[0], gaps, [len(recording)]])
    at = int(np.argmax(np.diff(edges)))
    part = slice(int(edges[at]), int(edges[at + 1]))
    return replace(recording, channels={name: values[part] for name, values in recording.channels.items()})


def read_recording(path: Path, required: Sequence[str] = ()) -> Recording:
    """Read a recording and check it; one that is too long for memory comes reduced (`hilbench.results.reduction`).

    The time must be finite and strictly increasing, and every channel in `required` there and finite; other
    channels may hold NaN (a value not known yet). Channels come as one-dimensional arrays, ``t_s`` first.
    Raises UnusableInputError, one line: file, line or sample, what was found and expected.
    """
    recording = read_rows(path)
    check_recording(recording, path)
    recording.require(required, path)
    return recording


def check_recording(recording: Recording, place: Path) -> None:
    """Raise UnusableInputError, naming `place`, unless the time is there, finite and strictly increasing."""
    if TIME not in recording:
        recording.require([TIME], place)
    time_s = recording.time_s
    _check_count(len(time_s), place)
    finite = np.isfinite(time_s)
    if not finite.all():
        raise UnusableInputError(
            place, f"{TIME} of sample {int(np.argmin(finite)) + 1} is no finite number, expected a time in s"
        )
    steps = np.diff(time_s)
    if not (steps > 0).all():
        at = int(np.argmin(steps > 0))
        raise UnusableInputError(
            place,
            f"{TIME} goes from {time_s[at]:g} s to {time_s[at + 1]:g} s in sample {at + 2},"
            " expected a strictly increasing time",
        )


def _kind(path: Path) -> str:
    suffixes = path.name.lower()
    for kind in _WRITERS:
        if suffixes.endswith(kind):
            return kind
    raise UnusableInputError(path, f"file name '{path.name}', {EXPECTED_FORMATS}")


def _check_count(samples: int, path: Path) -> None:
    if samples < LEAST_SAMPLES:
        raise UnusableInputError(path, f"{samples} sample(s), expected at least {LEAST_SAMPLES}")


def _is_in_pieces(path: Path) -> bool:
    """True if a recording is read piece by piece."""
    try:
        return _kind(path) == ".mf4" and is_ours(path)
    except OSError:  # whoever reads it says so
        return False


def _of_pieces(pieces: MdfPieces, chosen: Iterable[Mapping[str, NDArray[Any]]]) -> Recording:
    """Recording of the chosen pieces."""
    empty = {column.name: np.empty(0, column.dtype) for column in pieces.columns}
    return _from_columns(pieces, joined(chosen) or empty)


def _from_columns(pieces: MdfPieces, found: Mapping[str, NDArray[Any]]) -> Recording:
    channels = {
        # A run that goes on does not know yet whether all of its counts will be such.
        name: typed(name, values.astype(np.float64)) if values.dtype == np.int64 and find_signal(name) else values
        for name, values in found.items()
    }
    units = {column.name: column.unit for column in pieces.columns}
    start = None if pieces.start == NO_START_TIME else pieces.start
    return Recording(channels, start, pieces.comment, units, pieces.rows)


def _events_beside(path: Path, cycle_time_s: float) -> list[Event]:
    """Events by the journal of the run that left a recording."""
    journal = path.with_name("journal.log")
    return journal_events(read_journal(journal), cycle_time_s) if journal.is_file() else []


def _read_mdf(path: Path) -> Recording:
    if _is_in_pieces(path):
        pieces = MdfPieces(path)
        if pieces.rows * len(pieces.columns) <= MOST_VALUES:
            return _of_pieces(pieces, pieces)
        return _from_columns(pieces, reduced(pieces, partial(_events_beside, path)))
    channels, units, start, comment = read_mdf(path)
    return Recording(channels, None if start == NO_START_TIME else start, comment, units)


def _read_csv(path: Path) -> Recording:
    names, rows = read_table(path)
    columns = {name: typed(name, np.ascontiguousarray(rows[:, index])) for index, name in enumerate(names)}
    return Recording(_time_first(columns))


def _time_first(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return dict(sorted(columns.items(), key=lambda entry: entry[0] != TIME))


def _read_parquet(path: Path) -> Recording:
    pyarrow, parquet = _pyarrow(path)
    try:
        with open(path, "rb") as opened, parquet.ParquetFile(opened) as file:
            check_unpacked(file.metadata.num_rows * file.metadata.num_columns, path)
            return _parquet_channels(file.read(), pyarrow)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise UnusableInputError(path, f"not a readable Parquet file ({short_reason(error)})") from error


def _parquet_channels(table: Any, pyarrow: Any) -> Recording:
    columns = {
        field.name: np.ascontiguousarray(table[field.name].to_numpy())
        for field in table.schema
        if pyarrow.types.is_floating(field.type) or pyarrow.types.is_integer(field.type)
    }
    units = {
        field.name: field.metadata[b"unit"].decode()
        for field in table.schema
        if field.metadata and b"unit" in field.metadata
    }
    about = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    start = datetime.fromisoformat(about["start_time"]) if "start_time" in about else None
    return Recording(_time_first(columns), start, about.get("comment", ""), units)


_READERS = {".mf4": _read_mdf, ".csv": _read_csv, ".csv.gz": _read_csv, ".parquet": _read_parquet}
