"""Recordings as MDF4 that grow and are read in pieces (ASAM MDF 4.1; block names are the standard's).

A piece is what one `append` has written: a compressed data block (##DZ, transposed deflate: the samples of one channel
lie together, which halves the file) in each channel group. After each piece the file is whole: whoever reads it then,
whatever happened to its writer, finds all pieces.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, Final
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from hilbench.errors import UnusableInputError
from hilbench.files import require_file, usable

Columns = Mapping[str, NDArray[Any]]

#: Who has written a file, in its identification block: only such files are read by this module.
_PROGRAM: Final = b"hilbench"
_LITTLE_ENDIAN: Final = {"f": 4, "i": 2, "u": 0}  # data types of a channel: float, signed, unsigned
_KINDS: Final = {number: kind for kind, number in _LITTLE_ENDIAN.items()}
_HEAD: Final = struct.Struct("<4sIQQ")  # of a block: name, reserved, bytes, links
_DATA: Final = struct.Struct("<2sBBIQQ")  # of ##DZ: of which block, zip type, reserved, record bytes, bytes, zipped
_TRANSPOSED: Final = 1
#: isal's level 2 (of 0 to 3) packs 800 MB/s of samples into as little as zlib's level 1 does at 60 MB/s.
_LEVEL: Final = 2
#: Where links and counts stand in their blocks.
_DATA_LINK, _NEXT_LINK, _ROWS = 24 + 16, 24, 24 + 48 + 8
#: A longer text or piece is none of ours.
_LONGEST_TEXT, _MOST_PIECE_BYTES = 1 << 20, 1 << 28
#: Beside the comment of a file that does not have all samples at full rate (`hilbench.results.reduction`).
_THINNED: Final = '<common_properties><e name="full_rate">around_events</e></common_properties>'


@dataclass(frozen=True)
class Column:
    """A channel of a file: its name, type of its samples, unit, meaning, and the group it belongs to."""

    name: str
    dtype: np.dtype[Any]
    unit: str = ""
    meaning: str = ""
    group: str = ""


@dataclass
class _Group:
    columns: list[Column]
    dtype: np.dtype[Any]  #: of its records
    rows_at: int  #: where the file says how many there are
    link_at: int  #: where the link to the next piece goes


class MdfWriter:
    """Writes a new file piece by piece; `columns` have the time first; `thinned`: not all samples will be in it.

    Raises OSError, as `append` does.
    """

    def __init__(
        self, path: Path, columns: Sequence[Column], start: datetime, comment: str, *, thinned: bool = False
    ) -> None:
        self.rows = 0
        self._time = columns[0]
        groups: dict[str, list[Column]] = {}
        for column in columns[1:]:
            groups.setdefault(column.group, []).append(column)
        text, self._groups = _Layout(
            self._time, groups or {"": []}, start, _xml("HD", comment, _THINNED if thinned else "")
        ).made()
        self._file = open(path, "w+b", buffering=0)  # noqa: SIM115 (closed by `close`)
        self._end = 0
        self._append(text)

    def append(self, columns: Columns) -> None:
        """Add samples of all channels, of equal length."""
        count = len(columns[self._time.name])
        if not count:
            return
        text, links = bytearray(), []
        for group in self._groups:
            at = self._end + len(text)
            record = np.empty(count, group.dtype)
            for column in (self._time, *group.columns):
                record[column.name] = columns[column.name]
            data = _data_block(record)
            text += data
            links.append((group, self._end + len(text)))
            text += _block(b"##DL", [0, at], struct.pack("<BxxxIQ", 0, 1, self.rows * group.dtype.itemsize))
        self._append(bytes(text))
        self.rows += count
        for group, link in links:  # what is not linked yet nobody sees
            self._put(group.link_at, link)
            self._put(group.rows_at, self.rows)
            group.link_at = link + _NEXT_LINK

    def reader(self) -> IO[bytes]:
        """The file so far, whatever became of its name."""
        return open(f"/proc/self/fd/{self._file.fileno()}", "rb")

    def close(self) -> None:
        """Calling it twice is no error."""
        self._file.close()

    def _append(self, text: bytes) -> None:
        rest = memoryview(text)
        at = self._end
        while rest:
            done = os.pwrite(self._file.fileno(), rest, at)
            rest, at = rest[done:], at + done
        self._end = at

    def _put(self, at: int, value: int) -> None:
        os.pwrite(self._file.fileno(), value.to_bytes(8, "little"), at)


def _block(name: bytes, links: Sequence[int], content: bytes = b"") -> bytes:
    size = _HEAD.size + 8 * len(links) + len(content)
    return _HEAD.pack(name, 0, size, len(links)) + struct.pack(f"<{len(links)}Q", *links) + content + bytes(-size % 8)


def _data_block(record: NDArray[Any]) -> bytes:
    width = record.dtype.itemsize
    columns = np.ascontiguousarray(record.view(np.uint8).reshape(len(record), width).T)
    packed = isal_zlib.compress(columns.data, _LEVEL)
    head = _DATA.pack(b"DT", _TRANSPOSED, 0, width, record.nbytes, len(packed))
    return _block(b"##DZ", [], head + packed)


class _Layout:
    """The blocks in front of the data."""

    def __init__(self, time: Column, groups: Mapping[str, list[Column]], start: datetime, comment: bytes) -> None:
        self._time, self._of, self._start, self._comment = time, groups, start, comment
        self._text = bytearray()

    def made(self) -> tuple[bytes, list[_Group]]:
        identification = struct.pack("<8s8s8s4sH30sHH", b"MDF     ", b"4.10    ", _PROGRAM, b"", 410, b"", 0, 0)
        self._text += identification + bytes(104)  # room for the header block
        moment_ns = (self._start - datetime(1970, 1, 1, tzinfo=UTC)) // _MICROSECOND * 1000
        stamp = struct.pack("<QhhBB", moment_ns, 0, 0, 2, 0)
        comment = self._add(b"##MD", [], self._comment)
        made_by = self._add(b"##MD", [], _xml("FH", "recorded", "<tool_id>hilbench</tool_id>"))
        history = self._add(b"##FH", [0, made_by], stamp[:-1] + bytes(3))
        first, groups = 0, []
        for name, columns in reversed(list(self._of.items())):
            group, first = self._group(name, columns, first)
            groups.append(group)
        header = _block(b"##HD", [first, history, 0, 0, 0, comment], stamp + bytes(18))
        self._text[64 : 64 + len(header)] = header
        return bytes(self._text), groups[::-1]

    def _group(self, name: str, columns: list[Column], following: int) -> tuple[_Group, int]:
        """The group, and the address of its data group."""
        dtype = np.dtype([(column.name, column.dtype) for column in (self._time, *columns)])
        channel, offset = 0, dtype.itemsize
        for column in reversed((self._time, *columns)):
            offset -= column.dtype.itemsize
            channel = self._channel(column, offset, channel)
        named = self._add(b"##TX", [], _text(name)) if name else 0
        count = struct.pack("<QQHHIII", 0, 0, 0, 0, 0, dtype.itemsize, 0)
        group = self._add(b"##CG", [0, channel, named, 0, 0, named], count)
        listed = self._add(b"##HL", [0], struct.pack("<HB5x", 0, _TRANSPOSED))
        data = self._add(b"##DG", [following, group, 0, 0], bytes(8))
        # The first piece hangs on the header list, which hangs on the data group from the start.
        struct.pack_into("<Q", self._text, data + _DATA_LINK, listed)
        return _Group(columns, dtype, group + _ROWS, listed + _NEXT_LINK), data

    def _channel(self, column: Column, offset: int, following: int) -> int:
        master = column is self._time
        texts = [
            self._add(b"##TX", [], _text(each)) if each else 0 for each in (column.name, column.unit, column.meaning)
        ]
        kind = _LITTLE_ENDIAN[column.dtype.kind]
        what = struct.pack(
            "<BBBBIIIIBBH", 2 * master, master, kind, 0, offset, 8 * column.dtype.itemsize, 0, 0, 3, 0, 0
        )
        return self._add(b"##CN", [following, 0, texts[0], 0, 0, 0, *texts[1:]], what + bytes(48))

    def _add(self, name: bytes, links: Sequence[int], content: bytes) -> int:
        at = len(self._text)
        self._text += _block(name, links, content)
        return at


_MICROSECOND: Final = datetime(2000, 1, 1, 0, 0, 0, 1) - datetime(2000, 1, 1)


def _text(text: str) -> bytes:
    return text.encode() + b"\0"


def _xml(of: str, text: str, more: str = "") -> bytes:
    allowed = "".join(sign for sign in text if sign >= " " or sign in "\t\n\r")  # XML has no other control characters
    return _text(f"<{of}comment><TX>{escape(allowed)}</TX>{more}</{of}comment>")


# -- reading ---------------------------------------------------------------------------------------------------------


def is_ours(path: Path) -> bool:
    """True if `MdfWriter` has written a file. Raises OSError, UnusableInputError for what is no file."""
    require_file(path)
    with open(path, "rb") as file:
        head = file.read(64)
    return len(head) == 64 and head.startswith(b"MDF     4.10    " + _PROGRAM)


@dataclass
class _Found:
    """A channel group of a file that is read, and where its pieces are: address, packed bytes, samples."""

    dtype: np.dtype[Any]
    pieces: list[tuple[int, int, int]]


class MdfPieces:
    """A file that `MdfWriter` has written, or still writes, read piece by piece.

    Raises UnusableInputError, one line, for one that is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: list[Column] = []  #: all of them, the time first
        self._seen: set[int] = set()
        with usable(path, "read", "a recording"), open(path, "rb") as file:
            self._size = os.fstat(file.fileno()).st_size
            self.start, about, self._groups = self._head(file)
        self.comment = about.findtext("TX") or ""
        self.thinned = about.findtext(".//e") is not None  #: whether not all samples of the run are in it
        # The last piece may hang in some groups only, where its writer was killed.
        count = min(len(group.pieces) for group in self._groups)
        for group in self._groups:
            del group.pieces[count:]
        self.piece_rows = [rows for _, _, rows in self._groups[0].pieces]  #: samples of each piece
        if any([rows for _, _, rows in group.pieces] != self.piece_rows for group in self._groups):
            raise self._damaged("its groups have different pieces")

    @property
    def rows(self) -> int:
        """Samples of the whole file."""
        return sum(self.piece_rows)

    def __iter__(self) -> Iterator[dict[str, NDArray[Any]]]:
        """Piece after piece: the samples of all channels, the time first."""
        return self._of(self._groups)

    def having(self, names: Collection[str]) -> Iterator[dict[str, NDArray[Any]]]:
        """Piece after piece: at least the time and the channels with these names."""
        groups = [group for group in self._groups if {*names} & {*(group.dtype.names or ())[1:]}]
        return self._of(groups or self._groups[:1])

    def _of(self, groups: Sequence[_Found]) -> Iterator[dict[str, NDArray[Any]]]:
        with open(self.path, "rb") as file:
            for number in range(len(groups[0].pieces)):
                found: dict[str, NDArray[Any]] = {}
                for group in groups:
                    found |= self._samples(file, group, number)
                yield found

    def _samples(self, file: IO[bytes], group: _Found, number: int) -> dict[str, NDArray[Any]]:
        at, packed, rows = group.pieces[number]
        file.seek(at)
        width = group.dtype.itemsize
        unpacker = isal_zlib.decompressobj()
        try:
            data = unpacker.decompress(file.read(packed), rows * width + 1)
        except zlib.error as error:  # isal's own is this one
            raise self._damaged(f"the data at byte {at} can't be unpacked") from error
        if len(data) != rows * width:
            raise self._damaged(f"the data at byte {at} are not those of {rows} samples")
        planes, at = np.frombuffer(data, np.uint8).reshape(width, rows), 0
        found = {}
        for name in group.dtype.names or ():
            dtype = group.dtype[name]
            found[name] = _put_together(planes[at : at + dtype.itemsize], dtype)
            at += dtype.itemsize
        return found

    def _head(self, file: IO[bytes]) -> tuple[datetime, ElementTree.Element, list[_Found]]:
        links, content = self._block(file, 64, b"##HD", 6)
        moment_us = int.from_bytes(content[:8], "little") // 1000
        try:
            start = datetime(1970, 1, 1, tzinfo=UTC) + moment_us * _MICROSECOND
        except OverflowError as error:
            raise self._damaged("its start is no date") from error
        groups, at = [], links[0]
        while at:
            (at, group, data, _), _ = self._block(file, at, b"##DG", 4)
            groups.append(self._group(file, group, data))
        if not groups:
            raise self._damaged("no channel group in it")
        return start, self._comment(file, links[5]), groups

    def _group(self, file: IO[bytes], at: int, data: int) -> _Found:
        (_, channel, name, *_), content = self._block(file, at, b"##CG", 6)
        width = int.from_bytes(content[24:28], "little")
        group = self._text(file, name)
        fields: list[Column] = []
        offset = 0
        while channel:
            (channel, _, named, _, _, _, unit, meaning), what = self._block(file, channel, b"##CN", 8)
            kind, at_byte, bits = what[2], *struct.unpack_from("<II", what, 4)
            if kind not in _KINDS or bits not in (8, 16, 32, 64) or (kind == 4 and bits < 32) or at_byte != offset:
                raise self._damaged("a channel is none of hilbench's")
            offset += bits // 8
            dtype = np.dtype(f"<{_KINDS[kind]}{bits // 8}")
            texts = [self._text(file, each) for each in (named, unit, meaning)]
            fields.append(Column(texts[0], dtype, texts[1], texts[2], group))
        names = [column.name for column in fields]
        known = {column.name for column in self.columns[1:]}
        if offset != width or not fields or len({*names}) != len(names) or known & {*names[1:]} or "" in names:
            raise self._damaged("the channels of a group are not those of its records")
        if self.columns and fields[0] != self.columns[0] and fields[0].name != self.columns[0].name:
            raise self._damaged("a group has a time base of its own")
        self.columns += fields if not self.columns else fields[1:]
        dtype = np.dtype([(column.name, column.dtype) for column in fields])
        return _Found(dtype, list(self._pieces(file, data, dtype.itemsize)))

    def _pieces(self, file: IO[bytes], at: int, width: int) -> Iterator[tuple[int, int, int]]:
        (at, *_), _ = self._block(file, at, b"##HL", 1)
        while at:
            (at, data), _ = self._block(file, at, b"##DL", 2)
            head = self._read(file, data, _HEAD.size + _DATA.size)
            name, _, size, links = _HEAD.unpack_from(head)
            _, zipped, _, record, given, packed = _DATA.unpack_from(head, _HEAD.size)
            if (name, links, zipped, record) != (b"##DZ", 0, _TRANSPOSED, width) or given % width:
                raise self._damaged(f"the block at byte {data} holds no samples of its group")
            if given > _MOST_PIECE_BYTES or packed > size:
                raise self._damaged(f"the block at byte {data} has impossible sizes")
            if data + size > self._size and data + size > os.fstat(file.fileno()).st_size:
                raise self._damaged(f"the block at byte {data} is larger than the file")
            yield data + len(head), packed, given // width

    def _block(self, file: IO[bytes], at: int, name: bytes, links: int) -> tuple[tuple[int, ...], bytes]:
        """Its links, and what follows them."""
        if at in self._seen:
            raise self._damaged(f"a list of blocks comes back to byte {at}")
        self._seen.add(at)
        found, _, size, count = _HEAD.unpack(self._read(file, at, _HEAD.size))
        if found != name or count != links or not _HEAD.size + 8 * links <= size <= _LONGEST_TEXT:
            raise self._damaged(f"no block {name.decode()[2:]} at byte {at}")
        rest = self._read(file, at + _HEAD.size, size - _HEAD.size)
        if name != b"##DL" and name not in (b"##TX", b"##MD") and len(rest) < 8 * links + _LEAST[name]:
            raise self._damaged(f"the block at byte {at} is too short")
        return struct.unpack_from(f"<{links}Q", rest), rest[8 * links :]

    def _read(self, file: IO[bytes], at: int, count: int) -> bytes:
        if at + count > self._size:  # it may have grown since
            self._size = os.fstat(file.fileno()).st_size
        if at + count > self._size:
            raise self._damaged(f"cut off after {self._size} bytes")
        file.seek(at)
        return file.read(count)

    def _text(self, file: IO[bytes], at: int, name: bytes = b"##TX") -> str:
        if not at:
            return ""
        self._seen.discard(at)  # a text may be named twice
        _, content = self._block(file, at, name, 0)
        return content.partition(b"\0")[0].decode("utf-8", "replace")

    def _comment(self, file: IO[bytes], at: int) -> ElementTree.Element:
        try:
            return ElementTree.fromstring(self._text(file, at, b"##MD") or "<TX/>")
        except ElementTree.ParseError as error:
            raise self._damaged("its comment is no XML") from error

    def _damaged(self, how: str) -> UnusableInputError:
        return UnusableInputError(self.path, f"{how}, expected a whole MDF file")


def _put_together(planes: NDArray[np.uint8], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Numbers of their bytes, lowest first, shape (bytes, n): six times as fast as to transpose them."""
    whole = planes[0].astype(f"<u{dtype.itemsize}")
    for number, plane in enumerate(planes[1:], 1):
        whole |= plane.astype(whole.dtype) << np.array(8 * number, whole.dtype)
    found: NDArray[Any] = whole.view(dtype)
    return found


#: Bytes that a block has at least behind its links.
_LEAST: Final = {b"##HD": 8, b"##DG": 8, b"##CG": 32, b"##CN": 16, b"##HL": 0}
