"""Traces in the formats of other tools: ASC, BLF, TRC, candump logs, through python-can's readers and writers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from hilbench.can.frame import Frame
from hilbench.can.messages import to_frame, to_message
from hilbench.can.python_can import can
from hilbench.errors import UnusableInputError
from hilbench.files import writing
from hilbench.results.trace import TraceReader

#: Suffixes that python-can reads and writes; ``.log`` is read by `TraceReader`, which says what is wrong in which line.
FORMATS = (".log", ".asc", ".blf", ".trc")


def trace_format(path: Path) -> str:
    """The suffix. Raises UnusableInputError for another one."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise UnusableInputError(path, f"file name '{path.name}', expected a trace: {', '.join(FORMATS)}")
    return suffix


def read_trace(path: Path) -> Iterator[Frame]:
    """Frame by frame, with the times of the file. Raises UnusableInputError for what cannot be read."""
    if trace_format(path) == ".log":
        return iter(TraceReader(path))
    if not path.is_file():
        raise UnusableInputError(path, "no such file, expected a trace")
    return _through_python_can(path)


def _through_python_can(path: Path) -> Iterator[Frame]:
    empty = True
    try:
        with can.LogReader(path) as reader:
            for message in reader:
                if not message.is_error_frame:
                    empty = False
                    yield to_frame(message)
    except MemoryError:
        raise
    except Exception as error:  # its parsers raise whatever they stumble over: struct.error, zlib.error, KeyError, …
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UnusableInputError(path, f"not a readable {path.suffix} trace ({reason})") from error
    if empty:
        raise UnusableInputError(path, "no frame in it, expected a trace")


def write_trace(frames: Iterable[Frame], path: Path, channel: str) -> int:
    """Write frames in the format of the file name; returns how many. Raises UnusableInputError."""
    trace_format(path)
    count = 0
    with writing(path), can.Logger(path) as writer:
        for frame in frames:
            writer.on_message_received(to_message(frame, channel, is_rx=True))
            count += 1
    return count
