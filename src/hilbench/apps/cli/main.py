"""The `hilbench` command. Each command imports what it needs when it runs, so that `--help` is fast."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import Distribution, EntryPoints, PackageNotFoundError, entry_points, version
from typing import Annotated, Any, Final

import typer
from typer import Option
from typer.core import TyperGroup

from hilbench.crash_report import crash_report
from hilbench.entry_points import loaded
from hilbench.errors import HilbenchError, UnusableInputError
from hilbench.exit_status import ended

GROUP: Final = "hilbench.commands"
#: hilbench's own commands, entry points of that group, in the order of the help; those of other packages follow.
_OWN: Final = (
    "run", "demo", "check", "doctor", "simulate-drive", "simulate-hardware", "twin", "estop", "recover", "report",
    "sync", "diagnose", "examples", "scan", "boot", "gateway", "drive", "conformance", "replay", "monitor", "compare",
    "commission", "history", "what-if", "drift", "sweep", "convert", "compile", "dbc", "sdo", "lss", "config", "runs",
    "fmu",
)  # fmt: skip


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


class Commands(TyperGroup):
    """The commands; an error that typer itself would end with exit code 1 is reported as unusable input."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command. An operating system's refusal is an error like others, whoever's pipe has broken."""
        try:
            return super().invoke(ctx)
        except OSError as error:  # typer takes a broken pipe, whosever it is, for the terminal's
            raise _RefusedError(crash_report(error)) from error


class _RefusedError(HilbenchError):
    """The operating system refused what nobody foresaw that it would."""


def commands_named(name: str) -> Iterator[tuple[str, Any]]:
    """The command of this name, or where there is none all of them, with their names; other packages are searched only
    for a name that is not hilbench's. Those of other packages that can't be loaded are left out with a line each.

    Raises UnusableInputError for a command that is named, and for hilbench's own, when they can't be loaded.
    """
    own = _own_commands()
    named = own.select(name=name) or entry_points(group=GROUP, name=name)
    if named:
        yield name, loaded(next(iter(named)))
        return
    for each in _OWN:
        yield each, loaded(own[each])
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        if entry.name not in _OWN:
            try:
                yield entry.name, loaded(entry)
            except UnusableInputError as error:
                print(f"hilbench: {error}", file=sys.stderr)


def _own_commands() -> EntryPoints:
    try:
        own = Distribution.from_name("hilbench").entry_points.select(group=GROUP)
    except PackageNotFoundError:
        own = EntryPoints()
    if missing := [each for each in _OWN if each not in own.names]:
        text = f"what is installed lacks the command {missing[0]}, expected that of these sources: pip install it again"
        raise UnusableInputError("hilbench", text)
    return own
