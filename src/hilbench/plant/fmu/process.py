"""FMU process, from the bench's side: isolates the bench from the FMU's code.

A crash, an error status and a missing answer are one fault each (`BenchFaultError`, one line), after which the process
is ended. It ends when its connection closes, however the bench dies; the folder of the unpacked FMU is removed by
either of them.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import zipfile
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any, Final, NoReturn
from weakref import finalize

from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.plant.fmu.description import FmuDescription

#: Timeout for loading FMPy and the FMU, s.
_LONGEST_START_S: Final = 60.0
_END_TIMEOUT_S: Final = 2.0
_LOG: Final = "said.txt"
#: Most log messages of an FMU that are reported.
_MOST_MESSAGES: Final = 20


class FmuProcess:
    """Process of one instance of an FMU. `timeout_s`: of its answers; `report`: callback for the FMU's log messages.

    Raises UnusableInputError for an archive that can't be unpacked, BenchFaultError when the FMU can't be loaded.
    """

    def __init__(self, description: FmuDescription, timeout_s: float, report: Callable[[str], None]) -> None:
        self.name = f"FMU {description.path.name}"
        self._timeout_s, self._report = timeout_s, report
        self._messages = 0
        folder = Path(mkdtemp(prefix="hilbench-fmu-"))
        ours, theirs = socket.socketpair()
        self._connection = Connection(ours.detach())
        self._folder = folder
        try:
            _unpack(description.path, folder)
            arguments = [str(folder), str(description.version), description.identifier, description.token]
            with theirs, (folder / _LOG).open("wb") as log:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "hilbench.plant.fmu", str(theirs.fileno()), *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    pass_fds=(theirs.fileno(),),
                )
        except BaseException:
            rmtree(folder, ignore_errors=True)
            self._connection.close()
            raise
        self.close = finalize(self, _end, self._connection, self._process, folder)
        self._ask("open", (), _LONGEST_START_S, "is not loaded")

    def ask(self, request: str, *arguments: Any) -> Any:
        """Answer to a request of `instance.Instance`. Raises BenchFaultError; the process is ended then."""
        return self._ask(request, arguments, self._timeout_s, f"gave no answer to '{request}'")

    def _ask(self, request: str, arguments: tuple[Any, ...], timeout_s: float, silent: str) -> Any:
        if not self.close.alive:
            raise BenchFaultError(f"{self.name} has been ended, expected one that runs")
        try:
            self._connection.send((request, *arguments))
            if not self._connection.poll(timeout_s):
                self._fail(f"{silent} within {timeout_s:g} s")
            problem, value, log = self._connection.recv()
        except (EOFError, OSError):
            self._fail(f"{self._how_it_ended()} in '{request}'")
        for text in log:
            self._log(text)
        if problem:
            self._fail(problem)
        return value

    def _log(self, text: str) -> None:
        self._messages += 1
        if self._messages <= _MOST_MESSAGES:
            self._report(f"{self.name}: {text}")
        if self._messages == _MOST_MESSAGES:
            self._report(f"{self.name}: what else it logs is not shown")

    def _fail(self, problem: str) -> NoReturn:
        words = self._last_words()
        self.close()
        raise BenchFaultError(f"{self.name} {problem}{words}")

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            return "closed its connection"
        return f"crashed ({signal.Signals(-code).name})" if code < 0 else f"ended by itself (exit code {code})"

    def _last_words(self) -> str:
        try:
            lines = (self._folder / _LOG).read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            return ""
        return f"; it said: {lines[-1]}" if lines else ""


def _unpack(archive: Path, folder: Path) -> None:
    """Unpack into an empty folder; names that lead out of it stay in it (ensured by `zipfile`)."""
    try:
        with zipfile.ZipFile(archive) as file:
            file.extractall(folder)
    except (OSError, zipfile.BadZipFile, RuntimeError) as error:
        raise UnusableInputError(archive, f"{error}, expected an FMU that can be unpacked") from error


def _end(connection: Connection, process: subprocess.Popen[bytes], folder: Path) -> None:
    connection.close()
    try:
        process.wait(0.2)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    rmtree(folder, ignore_errors=True)
