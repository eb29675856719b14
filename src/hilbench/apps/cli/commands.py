"""The group of the commands, with the errors of the operating system told as what they are."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

from hilbench.crash_report import crash_report
from hilbench.errors import HilbenchError


class Commands(TyperGroup):
    """The commands; what typer itself would end with exit code 1 is told as what it is."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command. An operating system's refusal is an error like others, whoever's pipe has broken."""
        try:
            return super().invoke(ctx)
        except OSError as error:  # typer takes a broken pipe, whosever it is, for the terminal's
            raise _RefusedError(crash_report(error)) from error


class _RefusedError(HilbenchError):
    """The operating system refused what nobody foresaw that it would."""
