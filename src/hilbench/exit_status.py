"""Exit of a process of hilbench: every error becomes one line on standard error and the exit code of its kind."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hilbench.crash_report import crash_report
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED, EndSignal, HilbenchError
from hilbench.output import OutputError, hold_standard_descriptors, honest_output


def ended(command: Callable[[], object]) -> int:
    """Run a command with honest standard streams; its exit code."""
    # canopen logs what it also raises; the errors' own text is what a person needs.
    logging.getLogger("canopen").addHandler(logging.NullHandler())
    try:
        hold_standard_descriptors()
    except OSError:
        return EXIT_BENCH_FAULT  # nothing can be opened, and there is nowhere to say it
    try:
        with honest_output() as problems, _threads_reported(), _signals_raised():
            code = _code(command)
        for problem in problems:
            _report(str(problem))
    except KeyboardInterrupt as error:  # while these are set up or taken back
        return _interrupted(error)
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


@contextmanager
def _signals_raised() -> Iterator[None]:
    """Meanwhile SIGTERM and SIGHUP raise EndSignal, unless somebody else handles them, or ignores them (nohup)."""

    def end(number: int, _frame: object) -> None:
        if number == signal.SIGHUP:
            from hilbench.processes import leave_terminal

            leave_terminal()
        raise EndSignal(number)

    mine = []
    if threading.current_thread() is threading.main_thread():
        mine = [each for each in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(each) is signal.SIG_DFL]
    for number in mine:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.SIG_DFL)


def _interruption(end: SystemExit) -> KeyboardInterrupt | None:
    """What typer has made an exit of."""
    error: BaseException | None = end if end.code == EXIT_INTERRUPTED else None
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def _interrupted(error: KeyboardInterrupt) -> int:
    _report(f"interrupted ({error})" if str(error) else "interrupted")
    return error.exit_code if isinstance(error, EndSignal) else EXIT_INTERRUPTED


def _code(command: Callable[[], object]) -> int:
    try:
        command()
    except SystemExit as end:
        if interruption := _interruption(end):
            return _interrupted(interruption)
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        _report(str(end.code))  # as Python does
        return 1
    except OutputError as error:  # reported at the end, once, however it ended the command
        return error.exit_code
    except HilbenchError as error:
        _report(str(error), *getattr(error, "__notes__", ()))
        return error.exit_code
    except KeyboardInterrupt as error:
        return _interrupted(error)
    except BaseException as error:  # nobody foresaw it
        _report(crash_report(error))
        return EXIT_BENCH_FAULT
    return 0


def _report(*lines: str) -> None:
    for line in lines:
        print(f"hilbench: {line}", file=sys.stderr, flush=True)
