"""Exit of a process of hilbench: every error becomes one line on standard error and the exit code of its kind."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hilbench.crash_report import crash_report
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED, HilbenchError
from hilbench.output import OutputError, hold_standard_descriptors, honest_output


def ended(command: Callable[[], object]) -> int:
    """Run a command with honest standard streams; its exit code."""
    # canopen logs what it also raises; the errors' own text is what a person needs.
    logging.getLogger("canopen").addHandler(logging.NullHandler())
    try:
        hold_standard_descriptors()
    except OSError:
        return EXIT_BENCH_FAULT  # nothing can be opened, and there is no place for a message
    with honest_output() as problems, _threads_reported():
        code = _code(command)
    for problem in problems:
        _report(str(problem))
    return code or (EXIT_BENCH_FAULT if problems else 0)


@contextmanager
def _threads_reported() -> Iterator[None]:
    """Report an exception that ends a thread as well, in one line."""

    def report(ended: threading.ExceptHookArgs) -> None:
        if isinstance(ended.exc_value, Exception):
            _report(crash_report(ended.exc_value))

    before, threading.excepthook = threading.excepthook, report
    try:
        yield
    finally:
        threading.excepthook = before


def _code(command: Callable[[], object]) -> int:
    try:
        command()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        _report(str(end.code))  # as Python does
        return 1
    except OutputError as error:  # reported at the end, once, however it ended the command
        return error.exit_code
    except HilbenchError as error:
        _report(str(error), *getattr(error, "__notes__", ()))
        return error.exit_code
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BaseException as error:  # unexpected
        _report(crash_report(error))
        return EXIT_BENCH_FAULT
    return 0


def _report(*lines: str) -> None:
    for line in lines:
        print(f"hilbench: {line}", file=sys.stderr, flush=True)
