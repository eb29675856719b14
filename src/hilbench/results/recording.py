"""A recording: channels with one time base, as MDF4 (``.mf4``), CSV (``.csv``, ``.csv.gz``, a header row) or Parquet.

Channel names, units and descriptions are those of `hilbench.topology.signals`; a channel that is not in that list is
kept, its unit read from its name's suffix. Numbers survive every format exactly (CSV uses the shortest text that
reads back as the same binary64 number). What is too long for memory is read reduced (`hilbench.results.reduction`), or
a section of it.
"""

from __future__ import annotations

import gc
import gzip
import io
import logging
import os
import struct
import sys
import warnings
import zlib
from collections import deque
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
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
from hilbench.results.journal import read_journal
from hilbench.results.mdf import Column, MdfPieces, MdfWriter, is_ours
from hilbench.results.reduction import GAP_S, MOST_VALUES, joined, reduced
from hilbench.runs.events import Event, journal_events
from hilbench.topology.signal_kinds import TIME
from hilbench.topology.signals import find_signal, unit_of

#: Start time written into an MDF4 file when none is given, so that equal samples make equal files.
NO_START_TIME = datetime(2000, 1, 1, tzinfo=UTC)

#: Samples from which on there is something to draw or to evaluate; a run that ended earlier leaves no recording.
LEAST_SAMPLES = 2

_FORMATS = "expected a recording: .mf4, .csv, .csv.gz or .parquet"
#: Samples of a piece of a recording.
BLOCK_ROWS = 8192
#: Channels of a table as text, characters of the row that names them, and of all below it, at most.
MOST_COLUMNS, _LONGEST_HEADER, _MOST_CHARACTERS = 4096, 500_000, 500_000_000
#: The most that deflate can shrink data (RFC 1951: 258 bytes by two bits), and a little.
_DEFLATE_MOST = 1040
#: Values of all channels, and bytes of all texts, that are unpacked from MDF or Parquet, at most: 8 GB of values, which
#: 40 channels at 500 Hz fill in 13 hours.
_MOST_VALUES, _MOST_TEXT = 1_000_000_000, 1_000_000_000
_MDF_HEAD_BYTES = 64 + 104  # identification block and header block (ASAM MDF 4: IDBLOCK, HDBLOCK)


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
        """Whether it does not have all samples of its file."""
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


class RecordingBuilder:
    """Collects one row a cycle, cheaply and without ever copying what is there.

    `names` are the channels in the order of a row; the first must be ``t_s``. Those that are `whole` are int64 in a
    row, the others binary64. `expected_rows` are allocated and touched at once, so that a run of that length allocates
    nothing; a longer run goes on in further blocks.
    """

    def __init__(self, names: Sequence[str], expected_rows: int = BLOCK_ROWS, whole: Container[str] = ()) -> None:
        if not names or names[0] != TIME or len(set(names)) != len(names):
            raise ValueError(f"channels {list(names)}: expected distinct names, {TIME} first")
        self.names = tuple(names)
        self.whole = [name in whole for name in names]  #: by name
        self._row = struct.Struct("=" + "".join("q" if is_whole else "d" for is_whole in self.whole))
        self._row_size = self._row.size
        self._full: list[NDArray[np.float64]] = []
        self.used = np.zeros(1, np.int64)  #: rows of the block
        self._at = self.used.data  # one value goes faster through this
        self._open_block(max(expected_rows, 1))

    def _open_block(self, rows: int) -> None:
        self.block = np.full((rows, len(self.names)), np.nan)  #: of rows: those so far, and room for more
        self._bytes = self.block.data.cast("B")
        self.used[0] = 0

    def append(self, row: Sequence[float]) -> None:
        """Add one sample: a value per channel. Raises struct.error if the row has another length."""
        at = self._next_row()
        self._row.pack_into(self._bytes, at, *row)
        self._at[0] += 1

    def append_packed(self, row: memoryview) -> None:
        """The same of a row that is in memory already, as bytes. Raises ValueError if it has another length."""
        at = self._next_row()
        self._bytes[at : at + self._row_size] = row
        self._at[0] += 1

    def _next_row(self) -> int:
        """Where it begins in the bytes of the block."""
        if self._at[0] == len(self.block):
            self.next_block()
        return self._at[0] * self._row_size

    def next_block(self) -> None:
        """The block is full: go on in another one."""
        self._full.append(self.block)
        self._open_block(BLOCK_ROWS)

    def __len__(self) -> int:
        """Number of samples so far."""
        return sum(map(len, self._full)) + self._at[0]

    def build(self, start_time: datetime | None = None, comment: str = "") -> Recording:
        """What was recorded so far, as a copy; counts and bit fields become integers where every sample is one."""
        rows = np.concatenate([*self._full, self.block[: self._at[0]]])
        whole = rows.view(np.int64)
        channels = {
            name: typed(name, np.ascontiguousarray((whole if is_whole else rows)[:, column], np.float64))
            for column, (name, is_whole) in enumerate(zip(self.names, self.whole, strict=True))
        }
        return Recording(channels, start_time, comment)


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
    """What is written: what it is of, and its samples, piece by piece."""

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
    writer = MdfWriter(path, source.columns, start, source.comment, thinned=source.thinned)
    try:
        for piece in source.pieces:
            writer.append(piece)
    finally:
        writer.close()


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
    if not _is_in_pieces(path):
        return read_rows(path)
    pieces = MdfPieces(path)
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
    _check_time(recording.time_s, place)


def _kind(path: Path) -> str:
    suffixes = path.name.lower()
    for kind in _WRITERS:
        if suffixes.endswith(kind):
            return kind
    raise UnusableInputError(path, f"file name '{path.name}', {_FORMATS}")


def _check_count(samples: int, path: Path) -> None:
    if samples < LEAST_SAMPLES:
        raise UnusableInputError(path, f"{samples} sample(s), expected at least {LEAST_SAMPLES}")


def _check_time(time_s: NDArray[np.float64], path: Path) -> None:
    _check_count(len(time_s), path)
    finite = np.isfinite(time_s)
    if not finite.all():
        raise UnusableInputError(
            path, f"{TIME} of sample {int(np.argmin(finite)) + 1} is no finite number, expected a time in s"
        )
    steps = np.diff(time_s)
    if not (steps > 0).all():
        at = int(np.argmin(steps > 0))
        raise UnusableInputError(
            path,
            f"{TIME} goes from {time_s[at]:g} s to {time_s[at + 1]:g} s in sample {at + 2},"
            " expected a strictly increasing time",
        )


def _mdf_library() -> Any:
    """The MDF library, imported when first needed: it takes half a second."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import asammdf
    return asammdf


def _is_in_pieces(path: Path) -> bool:
    """Whether a recording is one that is read piece by piece."""
    try:
        return _kind(path) == ".mf4" and is_ours(path)
    except OSError:  # whoever reads it says so
        return False


def _of_pieces(pieces: MdfPieces, chosen: Iterable[Mapping[str, NDArray[Any]]]) -> Recording:
    """Those of its pieces."""
    empty = {column.name: np.empty(0, column.dtype) for column in pieces.columns}
    return _from_columns(
        pieces, joined(chosen, min(pieces.rows, MOST_VALUES // len(pieces.columns) + BLOCK_ROWS)) or empty
    )


def _from_columns(pieces: MdfPieces, found: Mapping[str, NDArray[Any]]) -> Recording:
    channels = {
        # A run that goes on does not know yet whether all of its counts will be such.
        name: typed(name, values.astype(np.float64)) if values.dtype == np.int64 and find_signal(name) else values
        for name, values in found.items()
    }
    units = {column.name: column.unit for column in pieces.columns}
    start = None if pieces.start == NO_START_TIME else pieces.start
    return Recording(channels, start, pieces.comment, units, pieces.rows)


def _read_pieces(path: Path) -> Recording:
    pieces = MdfPieces(path)
    if pieces.rows * len(pieces.columns) <= MOST_VALUES:
        return _of_pieces(pieces, pieces)
    return _from_columns(pieces, reduced(pieces, partial(_events_beside, path)))


def _events_beside(path: Path, cycle_time_s: float) -> list[Event]:
    """What the journal of the run says that left a recording."""
    journal = path.with_name("journal.log")
    return journal_events(read_journal(journal), cycle_time_s) if journal.is_file() else []


def _read_mdf(path: Path) -> Recording:
    if _is_in_pieces(path):
        return _read_pieces(path)
    _check_mdf_head(path)
    asammdf = _mdf_library()
    with _tracebacks_dropped():
        try:
            with asammdf.MDF(path) as mdf:
                _check_mdf_blocks(mdf, path)
                return _mdf_channels(mdf, path)
        except (UnusableInputError, MemoryError):
            raise
        except Exception as error:  # asammdf raises whatever its parser stumbles over: struct.error, KeyError, …
            found = _one_line(error)
        gc.collect()  # what it had half made
    raise UnusableInputError(path, f"not a readable MDF4 file ({found})")


@contextmanager
def _tracebacks_dropped() -> Iterator[None]:
    """Of a damaged file asammdf prints tracebacks, too: on standard output, by its logger, and when half-made objects
    are let go."""
    logger, hook = logging.getLogger("asammdf"), sys.unraisablehook
    logger.disabled, disabled = True, logger.disabled
    sys.unraisablehook = lambda _: None
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.disabled, sys.unraisablehook = disabled, hook


def _check_mdf_head(path: Path) -> None:
    """Refuse early what the library's destructor would answer with a traceback on standard error."""
    try:
        with open(path, "rb") as file:
            head = file.read(_MDF_HEAD_BYTES)
            size = os.fstat(file.fileno()).st_size
    except OSError as error:
        raise UnusableInputError(path, f"cannot be read ({error.strerror}), {_FORMATS}") from error
    if not head.startswith(b"MDF     4.") or len(head) < _MDF_HEAD_BYTES:
        raise UnusableInputError(path, f"not an MDF file of version 4, {_FORMATS}")
    if any(link >= size for link in struct.unpack_from("<6Q", head, 64 + 24)):  # links of the header block
        raise UnusableInputError(path, f"cut off after {size} bytes, expected a whole MDF file")
    _check_mdf_lists(path, struct.unpack_from("<2Q", head, 64 + 24))


def _check_mdf_lists(path: Path, first: Sequence[int]) -> None:
    """Refuse lists of blocks that never end: the library follows a block's first link for ever.

    `first`: the first data group and the first entry of the file history. Data groups lead to channel groups, and these
    to channels, by their second link.
    """
    seen: set[int] = set()
    waiting = list(first)
    size = path.stat().st_size
    with open(path, "rb") as file:
        while waiting:
            address = waiting.pop()
            if address == 0:
                continue
            if address in seen:
                raise UnusableInputError(
                    path, f"a list of blocks comes back to byte {address}, expected a whole MDF file"
                )
            seen.add(address)
            if address >= size:
                continue  # the library says what is missing
            file.seek(address)
            block = file.read(24 + 16)
            if len(block) == 24 + 16:
                following, inner = struct.unpack_from("<2Q", block, 24)
                waiting += [following, inner] if block[:4] in (b"##DG", b"##CG") else [following]


def _check_mdf_blocks(mdf: Any, path: Path) -> None:
    """Refuse sizes that can't be: the library's compiled part takes them as they are, and reads and writes by them."""
    size = path.stat().st_size
    _check_unpacked(sum(group.channel_group.cycles_nr * len(group.channels) for group in mdf.groups), path)
    texts = sum(block.original_size for group in mdf.groups for kept in group.signal_data for block in kept or ())
    if texts > _MOST_TEXT:
        raise UnusableInputError(
            path, f"texts of {texts / 1e6:.0f} MB when unpacked, expected at most {_MOST_TEXT / 1e6:.0f} MB"
        )
    for group in mdf.groups:
        info = group.channel_group
        record_bytes = info.samples_byte_nr + info.invalidation_bytes_nr
        blocks = list(group.get_data_blocks())
        if any(
            block.address + block.compressed_size > size or block.original_size > _DEFLATE_MOST * block.compressed_size
            for block in blocks
        ):
            raise UnusableInputError(path, "a data block is larger than the file, expected a whole MDF file")
        if sum(block.original_size for block in blocks) != info.cycles_nr * record_bytes:
            raise UnusableInputError(
                path, f"the data are not those of {info.cycles_nr} samples, expected a whole MDF file"
            )
        for channel in group.channels:
            if channel.byte_offset + (channel.bit_offset + channel.bit_count + 7) // 8 > record_bytes:
                raise UnusableInputError(
                    path, f"channel {channel.name} is outside its record, expected a whole MDF file"
                )


def _check_unpacked(values: int, path: Path) -> None:
    """Refuse what small files can unpack to."""
    if values > _MOST_VALUES:
        raise UnusableInputError(
            path, f"{values / 1e6:.0f} million values when unpacked, expected at most {_MOST_VALUES / 1e6:.0f} million"
        )


def _mdf_channels(mdf: Any, path: Path) -> Recording:
    channels: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for signal in mdf.iter_channels(skip_master=True):
        if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiu":
            continue  # text and structures are no channels of ours
        if TIME not in channels:
            channels[TIME] = np.array(signal.timestamps, np.float64)
        elif not np.array_equal(channels[TIME], signal.timestamps):
            raise UnusableInputError(path, f"channel {signal.name} has a time base of its own, expected one for all")
        if signal.name in channels and signal.name != TIME:
            raise UnusableInputError(path, f"channel {signal.name} is there twice, expected once")
        if signal.name != TIME:
            channels[signal.name] = np.array(signal.samples)
            units[signal.name] = signal.unit
    start = mdf.start_time.astimezone(UTC)
    return Recording(channels, None if start == NO_START_TIME else start, mdf.header.description or "", units)


def _read_csv(path: Path) -> Recording:
    try:
        with open_text(path) as file:
            names = _header(path, file.readline(_LONGEST_HEADER))
            rows = _rows(path, file, len(names))
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.strerror:
            reason = error.strerror
        else:
            reason = "not UTF-8 text" if isinstance(error, UnicodeDecodeError) else _one_line(error)
        raise UnusableInputError(path, f"cannot be read ({reason}), {_FORMATS}") from error
    columns = {name: typed(name, np.ascontiguousarray(rows[:, index])) for index, name in enumerate(names)}
    ordered = {TIME: columns.pop(TIME), **columns} if TIME in columns else columns
    return Recording(ordered)


def _read_parquet(path: Path) -> Recording:
    pyarrow, parquet = _pyarrow(path)
    try:
        with open(path, "rb") as opened, parquet.ParquetFile(opened) as file:
            _check_unpacked(file.metadata.num_rows * file.metadata.num_columns, path)
            return _parquet_channels(file.read(), pyarrow)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise UnusableInputError(path, f"not a readable Parquet file ({_one_line(error)})") from error


def _parquet_channels(table: Any, pyarrow: Any) -> Recording:
    columns = {
        field.name: np.ascontiguousarray(table[field.name].to_numpy())
        for field in table.schema
        if pyarrow.types.is_floating(field.type) or pyarrow.types.is_integer(field.type)
    }
    ordered = {TIME: columns.pop(TIME), **columns} if TIME in columns else columns
    units = {
        field.name: field.metadata[b"unit"].decode()
        for field in table.schema
        if field.metadata and b"unit" in field.metadata
    }
    about = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    start = datetime.fromisoformat(about["start_time"]) if "start_time" in about else None
    return Recording(ordered, start, about.get("comment", ""), units)


def open_text(path: Path, encoding: str = "utf-8-sig") -> IO[str]:
    """A table as text, unpacked if it is packed."""
    if path.suffix.lower() == ".gz":
        return gzip.open(path, "rt", encoding=encoding, newline=None)
    return open(path, encoding=encoding)


def rest_of_text(path: Path, file: IO[str]) -> io.StringIO:
    """What follows in a table as text. Raises UnusableInputError where it is more than can be read."""
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
        raise UnusableInputError(*_bad_line(path, lines, width)) from error
    if not rows.size:
        return np.empty((0, width))
    if rows.shape[1] != width:
        raise UnusableInputError(f"{path}:2", f"{rows.shape[1]} values, expected {width} as in the header")
    return np.asarray(rows, np.float64)


def _bad_line(path: Path, lines: Sequence[str], width: int) -> tuple[str, str]:
    for number, problem in _problems(lines, width):
        return f"{path}:{number}", problem
    return str(path), "not readable as numbers, expected a table separated by commas"


def _problems(lines: Sequence[str], width: int) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        fields = line.rstrip("\n").split(",")
        if len(fields) != width:
            yield number, f"{len(fields)} values, expected {width} as in the header"
        for position, text in enumerate(fields):
            try:
                float(text)
            except ValueError:
                yield number, f"value {position + 1} is '{text.strip()[:40]}', expected a number"


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


_READERS = {".mf4": _read_mdf, ".csv": _read_csv, ".csv.gz": _read_csv, ".parquet": _read_parquet}
