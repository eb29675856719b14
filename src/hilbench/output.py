"""Standard output and error in practice: terminals without UTF-8, pipes that close, disks that are full.

Characters that a stream's encoding lacks are replaced as one would type them (``>=`` for ≥). A failed write is
raised once, as an `OutputError`; from then on nothing more is tried, so that a run can still stop its drives and write
its result.
"""

from __future__ import annotations

import codecs
import io
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final, TextIO

from hilbench.errors import BenchFaultError

if TYPE_CHECKING:
    from typing_extensions import Buffer

#: Replacements of characters that ASCII lacks, where their decomposition (² → 2) would mean something else.
_TYPED: Final = {
    "·": "*",
    "×": "x",
    "²": "^2",
    "³": "^3",
    "±": "+-",
    "≥": ">=",
    "≤": "<=",
    "≈": "~",
    "∞": "inf",
    "→": "->",
    "←": "<-",
    "–": "-",
    "—": "-",
    "−": "-",
    "’": "'",
    "“": '"',
    "”": '"',
    "…": "...",
    "°": "deg",
    "µ": "u",
    "μ": "u",
    "Ω": "Ohm",
    "ω": "omega",
    "κ": "kappa",
    "ε": "epsilon",
    "σ": "sigma",
    "Δ": "delta ",
    "√": "sqrt",
    "✓": "ok",
    "✗": "x",
    "•": "*",
    "█": "#",
    "╺": "-",
    "╸": "-",
}
_NAME: Final = "hilbench-typed"


class OutputError(BenchFaultError):
    """Standard output can't be written: no message reaches the user any more."""


def _typed(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_typed_character, error.object[error.start : error.end])), error.end


def _typed_character(char: str) -> str:
    if char in _TYPED:
        return _TYPED[char]
    if "\u2500" <= char <= "\u257f":  # lines of tables
        return "-" if char in "─━═┄┈" else "|" if char in "│┃║" else "+"
    ascii_text = "".join(part for part in unicodedata.normalize("NFKD", char) if part.isascii())
    return ascii_text or char.encode("ascii", "backslashreplace").decode("ascii")


class _Descriptor(io.FileIO):
    """A stream's file that fails once (never without `problems`), and takes all after that without writing it."""

    def __init__(self, descriptor: int, problems: list[OutputError] | None) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._broken = False
        self._problems = problems

    def write(self, data: Buffer, /) -> int:
        size = memoryview(data).nbytes
        if self._broken:
            return size
        try:
            return super().write(data)
        except OSError as error:
            self._broken = True
            if self._problems is None:
                return size
            problem = OutputError(f"standard output cannot be written ({error.strerror})")
            self._problems.append(problem)
            raise problem from error


@contextmanager
def honest_output() -> Iterator[list[OutputError]]:
    """Standard output and error, for a whole command, through the above; streams without a file are left alone.

    An OutputError is raised by the first write to standard output that fails, and is in the list; on leaving it is
    only that. What standard error can't take is lost.
    """
    codecs.register_error(_NAME, _typed)
    before, problems = (sys.stdout, sys.stderr), list[OutputError]()
    sys.stdout, sys.stderr = _honest(sys.stdout, problems), _honest(sys.stderr, None)
    try:
        yield problems
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OutputError):
                if stream is not None:
                    stream.flush()
        sys.stdout, sys.stderr = before


def _honest(stream: TextIO, problems: list[OutputError] | None) -> TextIO:
    try:
        descriptor = stream.fileno()
    except (AttributeError, OSError, ValueError):  # none, in memory, or closed
        return stream
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Descriptor(descriptor, problems)),
        encoding=stream.encoding,
        errors=_NAME,
        line_buffering=stream.line_buffering if isinstance(stream, io.TextIOWrapper) else stream.isatty(),
    )


def hold_standard_descriptors() -> None:
    """Open those of 0, 1 and 2 that are closed: or the next file or socket would become standard output."""
    descriptor = 0
    while descriptor <= 2:
        descriptor = os.open(os.devnull, os.O_RDWR)
    os.close(descriptor)
