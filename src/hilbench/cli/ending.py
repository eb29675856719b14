"""How a command ends: every error becomes one line on standard error and the exit code of its kind."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from typer.core import TyperGroup

from hilbench.cli.output import OutputError, hold_standard_descriptors, honest_output
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED, HilbenchError
from hilbench.unexpected import unexpected


class Commands(TyperGroup):
    """The commands; what typer itself would end with exit code 1 is told as what it is."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command. An operating system's refusal is an error like others, whoever's pipe has broken."""
        try:
            return super().invoke(ctx)
        except OSError as error:  # typer takes a broken pipe, whosever it is, for the terminal's
            raise _RefusedError(unexpected(error)) from error


class _RefusedError(HilbenchError):
    """The operating system refused what nobody foresaw that it would."""


def ended(command: Callable[[], object]) -> int:
    """Run a command with honest standard streams; its exit code."""
    try:
        hold_standard_descriptors()
    except OSError:
        return EXIT_BENCH_FAULT  # nothing can be opened, and there is nowhere to say it
    with honest_output() as problems, _threads_told():
        code = _code(command)
    for problem in problems:
        _say(str(problem))
    return code or (EXIT_BENCH_FAULT if problems else 0)


@contextmanager
def _threads_told() -> Iterator[None]:
    """What ends a thread that nobody waits for is told as well, in one line."""

    def tell(ended: threading.ExceptHookArgs) -> None:
        if isinstance(ended.exc_value, Exception):
            _say(unexpected(ended.exc_value))

    before, threading.excepthook = threading.excepthook, tell
    try:
        yield
    finally:
        threading.excepthook = before


def _code(command: Callable[[], object]) -> int:
    try:
        command()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except OutputError as error:  # told at the end, once, however it ended the command
        return error.exit_code
    except HilbenchError as error:
        _say(str(error), *getattr(error, "__notes__", ()))
        return error.exit_code
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except Exception as error:  # nobody foresaw it
        _say(unexpected(error))
        return EXIT_BENCH_FAULT
    return 0


def _say(*lines: str) -> None:
    for line in lines:
        print(f"hilbench: {line}", file=sys.stderr, flush=True)
