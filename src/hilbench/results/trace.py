"""``trace.log``: every frame of a run in candump's log format, written as it happens.

    (1700000000.000123) vcan0 181#0011AABB      11-bit identifier: three hex digits
    (1700000000.000240) vcan0 18DAF110#0102     29-bit identifier: eight hex digits
    (1700000000.000300) vcan0 181#R8            remote frame with its data length
    (1700000000.000400) vcan0 20000080#0000000000000000   error frame: error class with CAN_ERR_FLAG

Traces of others may hold CAN FD frames (``181##1`` and the data, the digit: 1 BRS, 2 ESI) and the direction (R or T).

The format is that of ``candump -L`` (can-utils), which ``log2asc``, ``canplayer`` and python-can's
``CanutilsLogReader`` read. Each time stamp is the frame's own, cut to microseconds; one that lies before
its predecessor's is written as it is: a clock that jumped is something a trace must show.

A long trace goes on in ``trace.1.log``, ``trace.2.log``, …, which may be packed (``.log.gz``); `TraceReader` reads
all of them behind each other.
"""

from __future__ import annotations

import fcntl
import gzip
import math
import os
import re
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from threading import Thread
from typing import IO, Final, Self, cast

from isal import igzip

from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.errors import UnusableInputError
from hilbench.files import require_file, usable

_EXTENDED_MASK = 0x1FFFFFFF
_STANDARD_MASK = 0x7FF
_LONG_FLAGS = EXTENDED_FLAG | ERROR_FLAG
_KNOWN_HEADS = 4096  # identifiers whose text is kept; a bus of a bench has a few dozen
#: Where a disk has less space the trace ends: recording and result are to have it. It is looked for after so much more.
_LEAST_FREE: Final = 64_000_000
_LOOK_EVERY: Final = 8_000_000
#: At this share of what may be written a warning comes.
_WARN_AT: Final = 0.9


class TraceWriter:
    """Writes one line per frame; `end_cycle` hands what has collected to the operating system.

    What was handed over survives the end of the process, however abrupt (``kill -9``): at most the frames since
    the last `end_cycle` are lost. It is not forced onto the disk, so that no cycle waits for one: a power
    failure may cost the last seconds. Memory does not grow with the length of the run.

    While it is open the first file is locked (flock): who finds it unlocked knows that the run has ended.

    `path` must not exist yet (a trace is never overwritten); `channel` is the bus name in every line. A file of
    `part` bytes is followed by another one, packed if asked for; where there are `keep` bytes of lines, or the disk
    takes no more, the trace ends, and `warn` is called: the bench goes on.
    Raises UnusableInputError if the file cannot be created or the channel is not one word.
    """

    def __init__(
        self,
        path: Path,
        channel: str,
        *,
        keep: float = math.inf,
        part: float = math.inf,
        compress: bool = False,
        warn: Callable[[str], None] = lambda text: None,
    ) -> None:
        if not channel or not channel.isprintable() or " " in channel:
            raise UnusableInputError(path, f"channel {channel!r}, expected one word without blanks")
        self.path = path
        self.frames = 0  #: frames handed to the operating system so far
        self._channel = channel
        self._lines: list[str] = []
        self._waiting = 0  # frames in them
        self._heads: dict[int, str] = {}
        self.warn = warn
        self._keep, self._most_of_part, self._compress = keep, part, compress
        self._written = self._of_part = 0  # bytes, of all files and of the one that is written
        self._look_at, self._warn_at = _LOOK_EVERY, _WARN_AT * keep
        self._parts = 0  # further files
        self._packing: Thread | None = None
        self._ended = False
        self._seconds = -1
        self._seconds_text = ""
        with usable(path, "created", "a new file in a writable folder"):
            self._file = self._first = _new_file(path)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def write(self, frames: Iterable[Frame], sent_ns: int = 0) -> None:
        """Add frames in the order given.

        `sent_ns` (CLOCK_REALTIME, or the emulated bus' time) stamps the frames that carry no time of their
        own: those the bench itself sends.
        """
        add = self._lines.append
        heads, before = self._heads, len(self._lines)
        for can_id, data, time_ns in frames:
            seconds, rest_ns = divmod(time_ns or sent_ns, 1_000_000_000)
            if seconds != self._seconds:
                self._seconds = seconds
                self._seconds_text = f"({seconds}."
            head = heads.get(can_id) or self.head(can_id)
            body = f"R{len(data)}" if can_id & REMOTE_FLAG else data.hex().upper()
            add(f"{self._seconds_text}{rest_ns // 1000:06d}{head}{body}\n")
        self._waiting += len(self._lines) - before

    def write_lines(self, text: str, frames: int) -> None:
        """Add whole lines of so many frames."""
        self._lines.append(text)
        self._waiting += frames

    def head(self, can_id: int) -> str:
        """Text between time and data in the lines of an identifier."""
        identifier = (
            f"{can_id & (_EXTENDED_MASK | ERROR_FLAG):08X}" if can_id & _LONG_FLAGS else f"{can_id & 0x7FF:03X}"
        )
        head = f") {self._channel} {identifier}#"
        if len(self._heads) < _KNOWN_HEADS:
            self._heads[can_id] = head
        return head

    def end_cycle(self) -> None:
        """Hand the collected lines to the operating system in one write."""
        if not self._lines or self._ended:
            self._lines.clear()
            self._waiting = 0
            return
        text = "".join(self._lines).encode("ascii", "backslashreplace")
        count, self._waiting = self._waiting, 0
        self._lines.clear()
        try:
            rest = memoryview(text)
            while rest:
                rest = rest[os.write(self._file, rest) :]
            self.frames += count
            self._written += len(text)
            self._of_part += len(text)
            self._look()
        except OSError as error:
            self._end(f"the trace cannot be written ({error.strerror})")

    def _look(self) -> None:
        """Check the disk, and whether it is time for another file. Raises OSError."""
        if self._written >= self._keep:
            self._end(f"the trace has its {self._keep / 1e6:g} MB (trace: keep_MB)")
        elif self._written >= self._warn_at:
            self._warn_at = math.inf
            self.warn(f"{self.path}: {self._written / 1e6:.0f} MB of {self._keep / 1e6:g}, then the trace ends")
        elif self._written >= self._look_at:
            self._look_at = self._written + _LOOK_EVERY
            disk = os.statvfs(self.path.parent)
            if disk.f_bavail * disk.f_frsize < _LEAST_FREE:
                self._end(f"less than {_LEAST_FREE / 1e6:g} MB free, the trace takes no more of them")
        if self._of_part >= self._most_of_part and not self._ended:
            following = _new_file(part_of(self.path, self._parts + 1))
            self._close_part()
            self._parts, self._of_part, self._file = self._parts + 1, 0, following

    def _end(self, why: str) -> None:
        self._ended = True
        self.warn(f"{self.path}: {why}; the run continues without a trace")

    def _close_part(self) -> None:
        """The file that is written is full; the first one stays open, for its lock."""
        if self._file == self._first:
            return
        os.close(self._file)
        if self._compress:
            if self._packing is not None:
                self._packing.join()
            path = part_of(self.path, self._parts)
            self._packing = Thread(target=_pack, args=(path,), name="trace", daemon=True)
            self._packing.start()

    def close(self) -> None:
        """Write what is left and close the file. Calling it twice is no error."""
        if self._first < 0:
            return
        try:
            self.end_cycle()
        finally:
            self._close_part()
            if self._packing is not None:
                self._packing.join()
            os.close(self._first)
            self._file = self._first = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _new_file(path: Path) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o666)


def part_of(path: Path, number: int) -> Path:
    """A further file of a trace, numbered from 1."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}")


def parts_of(path: Path) -> list[Path]:
    """The files of a trace in their order, the first whether it is there or not."""
    found = [path]
    while True:
        following = part_of(path, len(found))
        packed = following.with_name(f"{following.name}.gz")
        if packed.exists():
            found.append(packed)
        elif following.exists():
            found.append(following)
        else:
            return found


def open_part(path: Path) -> IO[bytes]:
    """A file of a trace as it was before it was packed. Raises OSError."""
    return cast("IO[bytes]", gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb"))


def _pack(path: Path) -> None:
    """Put a full file into a packed one; where there is no space for it it stays as it is."""
    packed, unfinished = (path.with_name(f"{path.name}.gz{end}") for end in ("", ".part"))
    try:
        with open(path, "rb") as source, igzip.open(unfinished, "wb") as target:
            shutil.copyfileobj(source, target, 1 << 20)
        unfinished.replace(packed)
        path.unlink()
    except OSError:
        unfinished.unlink(missing_ok=True)


_LINE = re.compile(
    rb"\((?P<seconds>\d{1,11})\.(?P<fraction>\d{1,9})\) (?P<channel>\S+) "
    rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?:R(?P<length>[0-8]?)|(?P<data>(?:[0-9A-Fa-f]{2}){0,8})|"
    rb"#(?P<fd_flags>[0-9A-Fa-f])(?P<fd_data>(?:[0-9A-Fa-f]{2}){0,64}))(?: (?P<direction>[RT]))?"
)
_LONGEST_LINE = 512


class TraceReader:
    """Reads a trace back, frame by frame, with the files in which it goes on; any size takes the same memory.

    The last line of a trace that a crash cut off (it has no line end) is left out, and `torn` is then true:
    whether its data are complete cannot be known. `torn_too`: one that reads
    as a frame is taken all the same. `channels` collects the bus names met so far.

    Raises UnusableInputError, with file and line, on anything else that is not a classical CAN frame in
    candump's log format.
    """

    def __init__(self, path: Path, *, torn_too: bool = False) -> None:
        self.path = self._part = path
        self.torn = False
        self._torn_too = torn_too
        self.channels: set[str] = set()

    def __iter__(self) -> Iterator[Frame]:
        for number, match in self.lines():
            if match["fd_flags"] is not None:
                found = f"'{match.group().decode().split()[2]}', a CAN FD frame"
                raise UnusableInputError(f"{self._part}:{number}", f"{found}, expected classical CAN")
            yield self.frame(match, number)

    def lines(self) -> Iterator[tuple[int, re.Match[bytes]]]:
        """Number and parts of each line that holds a frame, of CAN FD as well."""
        parts = parts_of(self.path)
        for self._part in parts:
            yield from self._lines_of_part()
            if self.torn and self._part != parts[-1]:
                raise UnusableInputError(self._part, "its last line is cut off, expected it in the last file only")

    def _lines_of_part(self) -> Iterator[tuple[int, re.Match[bytes]]]:
        require_file(self._part)
        with usable(self._part, "read", "a trace"):
            file = open_part(self._part)
        with file:
            number = 0
            while line := self._next(file):
                number += 1
                if not line.endswith(b"\n"):
                    self.torn = True
                    if file.read(1):
                        text = "a line without end, expected a trace in candump format"
                        raise UnusableInputError(f"{self._part}:{number}", text)
                    if not (self._torn_too and _LINE.fullmatch(line)):
                        return
                if line.strip():
                    yield number, self._match(line, number)

    def _next(self, file: IO[bytes]) -> bytes:
        try:
            return file.readline(_LONGEST_LINE)
        except (OSError, EOFError, zlib.error) as error:
            raise UnusableInputError(self._part, f"cannot be read ({error}), expected a trace") from error

    def _match(self, line: bytes, number: int) -> re.Match[bytes]:
        match = _LINE.fullmatch(line.rstrip())
        if match is None:
            found = line[:60].decode("ascii", "backslashreplace").strip()
            raise UnusableInputError(
                f"{self._part}:{number}", f"'{found}', expected a frame such as (1700000000.000123) vcan0 181#0011AABB"
            )
        self.channels.add(match["channel"].decode("ascii", "backslashreplace"))
        return match

    def frame(self, match: re.Match[bytes], number: int) -> Frame:
        """The frame of a line; of CAN FD with the data that it has."""
        can_id = int(match["id"], 16)
        if len(match["id"]) > 3 and not can_id & ERROR_FLAG:
            can_id |= EXTENDED_FLAG
        elif len(match["id"]) == 3 and can_id > _STANDARD_MASK:
            raise UnusableInputError(f"{self._part}:{number}", f"identifier {can_id:X}h, expected at most 7FFh")
        held = match["data"] if match["fd_flags"] is None else match["fd_data"]
        if held is None:
            can_id |= REMOTE_FLAG
        data = bytes.fromhex(held.decode()) if held is not None else bytes(int(match["length"] or 0))
        nanoseconds = int(match["fraction"].ljust(9, b"0"))
        return Frame(can_id, data, int(match["seconds"]) * 1_000_000_000 + nanoseconds)
