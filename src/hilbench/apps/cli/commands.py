"""The commands: entry points of the group ``hilbench.commands``, hilbench's own and those of other packages.

Each is a function whose signature typer reads, or a `typer.Typer` with commands of its own.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, EntryPoints, PackageNotFoundError, entry_points
from typing import Any, Final

from typer.core import TyperGroup

from hilbench.crash_report import crash_report
from hilbench.entry_points import loaded
from hilbench.errors import HilbenchError, UnusableInputError

GROUP: Final = "hilbench.commands"
#: hilbench's own, in the order of the help; those of other packages follow.
_OWN: Final = (
    "run", "demo", "check", "doctor", "simulate-drive", "simulate-hardware", "twin", "estop", "recover", "report",
    "sync", "diagnose", "examples", "scan", "boot", "gateway", "drive", "conformance", "replay", "monitor", "compare",
    "commission", "history", "what-if", "drift", "sweep", "convert", "compile", "dbc", "sdo", "lss", "config", "runs",
    "fmu",
)  # fmt: skip


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
