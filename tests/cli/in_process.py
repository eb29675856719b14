"""A `hilbench` command in this process, by its own entry point: a process of its own imports for over a second."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from unittest.mock import patch

from hilbench.apps.cli.main import main
from hilbench.canopen import master_guard


def hilbench(*arguments: object, typed: str = "") -> subprocess.CompletedProcess[str]:
    """Exit code and what was printed; standard input and output are no terminals."""
    words, out, err = ["hilbench", *map(str, arguments)], io.StringIO(), io.StringIO()
    code: int | str | None = 0
    with (
        patch.object(sys, "argv", words),
        patch.object(sys, "stdin", io.StringIO(typed)),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code
    return subprocess.CompletedProcess(words, int(code or 0), out.getvalue(), err.getvalue())


@contextmanager
def nobody_else() -> Iterator[None]:
    """On a bus that nobody else uses: who writes to it listens for another master less long than over a second."""
    with patch.object(master_guard, "LISTEN_S", 0.05):
        yield
