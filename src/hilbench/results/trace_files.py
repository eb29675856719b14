"""Traces in the formats of other tools: ASC, BLF, TRC, candump logs, through python-can's readers and writers.

What a format does not hold of a frame shows when the file that was written is read back beside its source
(`convert_trace`): nothing is lost without a word, whatever a writer does.
"""

from __future__ import annotations

import logging
import os
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from hilbench.can.adapter import to_frame, to_message
from hilbench.can.frame import ERROR_FLAG, Frame
from hilbench.can.python_can import can
from hilbench.errors import EXIT_CRITERION_FAILED, HilbenchError, UnusableInputError, one_line
from hilbench.files import written_whole
from hilbench.results.trace import TraceReader

#: Of one container, at most; writers begin a new one at 128 kB.
_MOST_BYTES: Final = 100_000_000
#: Offset of the size of the file's header, and the head of an object: signature, size with the head, type.
_HEADER_SIZE: Final = struct.Struct("<4sL")
_OBJECT: Final = struct.Struct("<4sHHLL")
_CONTAINER: Final = 10
#: What a container has before its data: method (2: zlib) and its own word on the size.
_CONTAINER_HEAD: Final = struct.Struct("<H6xL4x")
_ZLIB: Final = 2
#: Suffixes that python-can reads and writes; ``.log`` is read by `TraceReader`, which says what is wrong in which line.
FORMATS = (".log", ".asc", ".blf", ".trc")
_BRS, _ESI = 1, 2
_BUS_ERROR = 0x80
#: Formats count microseconds; those that count from a start add the rounding of that.
_SAME_TIME_S: Final = 5e-6
#: No trace is older, so such times count from the start of the measurement.
_NO_DATE_BEFORE_S: Final = datetime(1980, 1, 1, tzinfo=UTC).timestamp()


def check_containers(path: Path) -> None:
    """Raise UnusableInputError for a container that is too large when unpacked; what else is wrong a reader says."""
    with open(path, "rb") as file:
        head = file.read(_HEADER_SIZE.size)
        if len(head) < _HEADER_SIZE.size:
            return
        file.seek(_HEADER_SIZE.unpack(head)[1])
        while len(head := file.read(_OBJECT.size)) == _OBJECT.size:
            signature, _, _, size, kind = _OBJECT.unpack(head)
            left = size - _OBJECT.size
            if signature != b"LOBJ" or left < 0:
                return
            if kind == _CONTAINER:
                _check(file.read(left), path)
            else:
                file.seek(left, os.SEEK_CUR)
            file.seek(size % 4, os.SEEK_CUR)


def _check(container: bytes, path: Path) -> None:
    if len(container) < _CONTAINER_HEAD.size or _CONTAINER_HEAD.unpack_from(container)[0] != _ZLIB:
        return
    try:
        unpacked = zlib.decompressobj().decompress(container[_CONTAINER_HEAD.size :], _MOST_BYTES + 1)
    except zlib.error:
        return
    if len(unpacked) > _MOST_BYTES:
        raise UnusableInputError(
            path, f"a container of more than {_MOST_BYTES / 1e6:g} MB when unpacked, expected at most that"
        )


def _ignore(_: str) -> None:
    """Ignore a note."""


def trace_format(path: Path) -> str:
    """The suffix. Raises UnusableInputError for another one."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise UnusableInputError(path, f"file name '{path.name}', expected a trace: {', '.join(FORMATS)}")
    return suffix


def read_trace(path: Path) -> Iterator[Frame]:
    """Frame by frame, with the times of the file. Raises UnusableInputError for what cannot be read, and for CAN FD."""
    if trace_format(path) == ".log":
        return iter(TraceReader(path))
    return (to_frame(_classical(message, path)) for message in read_messages(path))


def _classical(message: can.Message, path: Path) -> can.Message:
    if message.is_fd:
        raise UnusableInputError(path, f"a CAN FD frame at {message.timestamp:.6f} s, expected classical CAN")
    return message


def read_messages(path: Path, note: Callable[[str], None] = _ignore) -> Iterator[can.Message]:
    """Read all messages of a trace, with the times, channels and directions of the file.

    `note` gets what it does not contain, or can't be read of it. Raises UnusableInputError for what is no trace.
    """
    if trace_format(path) == ".log":
        return _of_candump(path, note)
    if not path.is_file():
        raise UnusableInputError(path, "no such file, expected a trace")
    if path.suffix.lower() == ".blf":
        check_containers(path)
    return _through_python_can(path, note)


def _of_candump(path: Path, note: Callable[[str], None]) -> Iterator[can.Message]:
    reader, taken = TraceReader(path, torn_too=True), False
    for number, match in reader.lines():
        message = to_message(reader.frame(match, number), match["channel"].decode(), is_rx=match["direction"] != b"T")
        if match["fd_flags"] is not None:
            flags = int(match["fd_flags"], 16)
            message.is_fd = True
            message.bitrate_switch, message.error_state_indicator = bool(flags & _BRS), bool(flags & _ESI)
        taken = reader.torn
        yield message
    if reader.torn:
        note(f"the last line has no line end, its data may be cut off: {'taken as it is' if taken else 'left out'}")


def _through_python_can(path: Path, note: Callable[[str], None]) -> Iterator[can.Message]:
    first = True
    try:
        with _complaints(note), _reader(path, note) as reader:
            for message in reader:
                if path.suffix.lower() == ".trc" and isinstance(message.channel, int):
                    message.channel -= 1  # python-can's reader counts from 1, its writer and the other readers from 0
                if first and message.timestamp < _NO_DATE_BEFORE_S:
                    note("it says no date: times count from the start of the measurement")
                first = False
                yield message
    except (MemoryError, UnusableInputError):
        raise
    except Exception as error:  # its parsers raise whatever they stumble over: struct.error, zlib.error, KeyError, …
        raise UnusableInputError(path, f"not a readable {path.suffix} trace ({one_line(error)})") from error
    if first:
        raise UnusableInputError(path, "no frame in it, expected a trace")


def _reader(path: Path, note: Callable[[str], None]) -> can.io.generic.MessageReader:
    """python-can's; of an ASC file with the date of the measurement."""
    if path.suffix.lower() != ".asc":
        return can.LogReader(path)
    try:
        with can.ASCReader(path, relative_timestamp=False) as reader:
            next(iter(reader), None)
    except ValueError as error:
        if not str(error).startswith("Incompatible datetime"):
            raise
        note(f"its date is not understood ({error}): left out")
        return can.ASCReader(path)
    if reader.timestamps_format == "relative":
        raise UnusableInputError(path, "time stamps relative to the line before, expected absolute ones")
    return can.ASCReader(path, relative_timestamp=False)


@contextmanager
def _complaints(note: Callable[[str], None]) -> Iterator[None]:
    """Meanwhile what python-can leaves out of a file, and only logs, is noted: each kind once, with its number."""
    found: Counter[str] = Counter()

    class Counting(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found[str(record.msg).partition("'")[0].strip()] += 1

    logger, handler = logging.getLogger("can.io"), Counting(logging.INFO)
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
    for text, count in found.items():
        note(f"{count} × {text}")


class TraceLossError(HilbenchError):
    """A format does not hold all that a trace has."""

    exit_code = EXIT_CRITERION_FAILED


def convert_trace(source: Path, target: Path, note: Callable[[str], None], *, allow_loss: bool) -> int:
    """Write a trace in the format of the other file name; returns how many frames it holds.

    `note` gets what could not be read, and, with `allow_loss`, what is lost; without, that raises TraceLossError, and
    nothing is written. Raises UnusableInputError.
    """
    channels = _Channels(named=trace_format(target) == ".log")
    if next(read_messages(source), None) is None:
        raise UnusableInputError(source, "no frame in it, expected a trace")
    count, lost = 0, Counter[str]()
    with written_whole(target) as partial:
        with _complaints(_ignore):
            _write(channels.renamed(read_messages(source, note)), partial)
        written = read_messages(partial)
        there = next(written, None)
        for message in channels.renamed(read_messages(source)):
            if there is None or not _is_of(there, message):
                lost[_kind(message)] += 1
                continue
            count += 1
            held = _parts(there)
            lost.update(f"{name} of a frame" for name, value in _parts(message).items() if held.get(name) != value)
            there = next(written, None)
        if lost:
            text = f"{target.suffix} does not hold {', '.join(f'{n} × {what}' for what, n in lost.items())}"
            if not allow_loss:
                raise TraceLossError(f"{target}: {text} ({source}), expected another format, or --allow-loss")
            note(text)
    if text := channels.without_names():
        note(text)
    return count


class _Channels:
    """Names of the buses in a file: by name, or by number from 0 as python-can counts."""

    def __init__(self, *, named: bool) -> None:
        self._named = named
        self._numbers: dict[str, int] = {}

    def renamed(self, messages: Iterator[can.Message]) -> Iterator[can.Message]:
        """Messages with the file's names of their buses."""
        for message in messages:
            name = message.channel if isinstance(message.channel, str) else f"can{message.channel or 0}"
            message.channel = name if self._named else self._number(name)
            yield message

    def _number(self, name: str) -> int:
        if name not in self._numbers:
            number = int(digits[0][-2:]) if (digits := re.findall(r"\d+$", name)) else 0
            while number in self._numbers.values():
                number += 1
            self._numbers[name] = number
        return self._numbers[name]

    def without_names(self) -> str:
        """Text about the names that are lost; "": none."""
        lost = [f"{name} is {number + 1}" for name, number in self._numbers.items() if name != f"can{number}"]
        return f"channels have numbers in it: {', '.join(lost)}" if lost else ""


def _write(messages: Iterator[can.Message], path: Path) -> None:
    if path.suffix.lower() == ".log":
        with open(path, "w", encoding="utf-8", errors="surrogateescape") as file:
            file.writelines(map(_candump_line, messages))
        return
    with can.Logger(path) as writer:
        for message in messages:
            if isinstance(writer, can.ASCWriter) and not writer.header_written:
                # Its date has milliseconds, without leading zeros: only whole seconds are read as they were written.
                writer.log_event("Start of measurement", float(int(message.timestamp)))
            writer.on_message_received(message)


def _candump_line(message: can.Message) -> str:
    seconds, microseconds = divmod(round(message.timestamp * 1e6), 1_000_000)
    data = message.data.hex().upper()
    if message.is_error_frame:
        identifier = f"{ERROR_FLAG | (message.arbitration_id or _BUS_ERROR):08X}"
        data = data or "00" * 8
    else:
        identifier = f"{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"
    if message.is_remote_frame:
        data = f"R{message.dlc}"
    elif message.is_fd:
        data = f"#{_BRS * message.bitrate_switch | _ESI * message.error_state_indicator}{data}"
    return f"({seconds}.{microseconds:06d}) {message.channel} {identifier}#{data} {'R' if message.is_rx else 'T'}\n"


def _is_of(written: can.Message, message: can.Message) -> bool:
    """True if `written` is what was written of `message`."""
    same = written.is_error_frame == message.is_error_frame and (
        message.is_error_frame or written.arbitration_id == message.arbitration_id
    )
    return same and abs(written.timestamp - message.timestamp) < _SAME_TIME_S


def _kind(message: can.Message) -> str:
    kinds = {
        "error frame": message.is_error_frame,
        "remote frame": message.is_remote_frame,
        "CAN FD frame": message.is_fd,
    }
    return next((name for name, it_is in kinds.items() if it_is), "frame at its time")


def _parts(message: can.Message) -> dict[str, Any]:
    """Parts of a frame by their names."""
    if message.is_error_frame:
        what = {"error class": message.arbitration_id} if message.arbitration_id else {}  # only some formats say it
        return {"channel": message.channel, **what, **({"data": bytes(message.data)} if any(message.data) else {})}
    return {
        "channel": message.channel,
        "direction": message.is_rx,
        "format": (message.is_extended_id, message.is_remote_frame, message.is_fd),
        "bit rate switch or error state": (message.bitrate_switch, message.error_state_indicator),
        "length": message.dlc,
        "data": bytes(message.data),
    }
