"""The errors that reach a person, and the exit code each of them means (design: exit codes)."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from pathlib import Path

EXIT_PASSED = 0
EXIT_CRITERION_FAILED = 1
EXIT_UNUSABLE_INPUT = 2
EXIT_BENCH_FAULT = 3
EXIT_INTERRUPTED = 130


#: Most characters shown of a place, or of a problem; the part between the beginning and the end of a longer one
#: is left out.
_LONGEST_TEXT = 1500
#: Most errors shown in addition to the first one.
_MOST_NOTES = 40


class EndSignal(KeyboardInterrupt):
    """SIGTERM or SIGHUP has come: ends what Ctrl-C ends, so that files, buses and drives are left in order."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


class HilbenchError(Exception):
    """Base of the errors that are shown to a person as one line."""

    exit_code = EXIT_BENCH_FAULT


class UnusableInputError(HilbenchError):
    """A file or an argument that cannot be used: where, what was found, what was expected.

    The text is always one printable line of bounded length, whatever the file has: ``place: found, expected ...``.
    """

    exit_code = EXIT_UNUSABLE_INPUT

    def __init__(self, place: str | Path, problem: str) -> None:
        self.place, self.problem = _shortened(printable(str(place))), _shortened(printable(problem))
        super().__init__(f"{self.place}: {self.problem}")

    @classmethod
    def of(cls, errors: Sequence[UnusableInputError]) -> UnusableInputError:
        """One error of several: the first one, with the number of the others, the next ones as its notes."""
        first, *others = errors
        if not others:
            return first
        error = cls(first.place, f"{first.problem} (and {len(others)} more)")
        for other in others[:_MOST_NOTES]:
            error.add_note(str(other))
        return error


def printable(text: str) -> str:
    """One line, with control characters escaped: they could move a terminal's cursor, or fake another message."""
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def one_line(error: BaseException) -> str:
    """Reason of a library's error, on one line."""
    return " ".join(str(error).split()) or type(error).__name__


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else f"{text[: _LONGEST_TEXT // 2]} … {text[-_LONGEST_TEXT // 2 :]}"


class BenchFaultError(HilbenchError):
    """The bench failed while it ran (a node that does not answer, a lost bus, a limit) and was made safe."""

    exit_code = EXIT_BENCH_FAULT

    def add_cause(self, text: str) -> None:
        """Append an earlier event to the same line."""
        self.args = (f"{self}; before that, {text}",)

    def add_consequence(self, text: str) -> None:
        """Append a consequence to the same line."""
        self.args = (f"{self}; {text}",)


class UnusableValueError(BenchFaultError, ValueError):
    """A running bench was given a value that a quantity can't have; the bench is not changed."""


class BenchNotRunningError(BenchFaultError, RuntimeError):
    """A bench was used that has not been entered yet, or has been left."""


class BusError(BenchFaultError):
    """The bus cannot be opened, or was lost."""


class EmergencyStopError(BenchFaultError):
    """The bench was stopped over the bus."""


class NoAnswerError(BenchFaultError):
    """A participant did not answer a SYNC."""
