"""The `hilbench` command. Each command imports what it needs when it runs, so that `--help` is fast."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from typing import Annotated, Any

import typer
from typer import Option

from hilbench.apps.cli.commands import Commands, commands_named
from hilbench.exit_status import ended


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"hilbench {version('hilbench')}")
        raise typer.Exit


def hilbench(
    show_version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="print the version and exit")
    ] = False,
) -> None:
    """Hardware-in-the-loop test bench over CAN/CANopen with a synchronized twin of the machine."""


def command_line(name: str = "") -> typer.Typer:
    """The command line with the command of this name alone; with all of them where none has it.

    Raises UnusableInputError where hilbench's own commands are not those that are installed.
    """
    app = typer.Typer(
        name="hilbench",
        cls=Commands,
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},  # the commands inherit it
    )
    app.callback()(hilbench)
    for each, command in commands_named(name):
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=each)
        else:
            app.command(each)(command)
    return app


@cache
def _command(name: str) -> Callable[[], object]:
    """Command as a callable, once in a process: commands are made from their signatures, which takes longer than
    many."""
    return _with_flowing_help(typer.main.get_command(command_line(name)))


def _with_flowing_help(command: Any) -> Callable[[], object]:
    """A command, and those below it, whose help goes to the width of the terminal, not to that of the source."""
    if command.help:
        command.help = "\n\n".join(" ".join(part.split()) for part in command.help.split("\n\n"))
    for each in getattr(command, "commands", {}).values():
        _with_flowing_help(each)
    flowing: Callable[[], object] = command
    return flowing


#: What a command imports stays: to look through it for garbage as often as Python does takes a sixth of its start.
_NEW_OBJECTS_BEFORE_COLLECTION = 10_000
#: Matrices are many and small: threads of one product wait for each other for longer than they work. To look for
#: plugins of pydantic in all that is installed takes 28 ms; a command needs none.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "PYDANTIC_DISABLE_PLUGINS": "__all__"}


def main() -> None:
    """Entry point: errors meant for a person become one line on standard error and the exit code of their kind."""
    gc.set_threshold(_NEW_OBJECTS_BEFORE_COLLECTION)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    sys.exit(ended(lambda: _command(next(iter(sys.argv[1:]), ""))()))
