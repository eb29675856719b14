"""Child processes of a bench: simulated hardware and twin; they start with it and never outlive it.

A child ends on SIGTERM, and by itself when its standard input closes, which the kernel does in whatever way the
bench dies.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hilbench.crash_report import TRACEBACK_FOLDER
from hilbench.errors import BenchFaultError, EndSignal
from hilbench.forked_workers import ForkedWorker

_END_TIMEOUT_S = 5.0


class ChildProcess:
    """A child process of the bench, by its arguments after ``python -m``; its output goes to a log file.

    `pass_fds`: open files that it inherits in addition to its standard ones, by the same numbers; it can't be started
    again then. `environment`: variables in addition to those of this process. `copy`: becomes it, in place of a new
    interpreter; one that is started again is a new one.
    Raises BenchFaultError when the system refuses to start it.
    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        log_path: Path,
        pass_fds: Sequence[int] = (),
        environment: Mapping[str, str] = MappingProxyType({}),
        copy: ForkedWorker | None = None,
    ) -> None:
        self.name = name
        #: Frames it lost because it did not read in time; None: it has not ended in order, or its bus does not count.
        self.lost_frames: int | None = None
        self._log_path = log_path
        self._arguments = list(arguments)
        self._pass_fds = tuple(pass_fds)
        self._environment = {
            **environment,
            FOLLOW_PARENT: "1",
            TRACEBACK_FOLDER: str(self._log_path.parent),
        }
        self._process = self._start(copy)

    def _start(self, copy: ForkedWorker | None = None) -> subprocess.Popen[bytes] | ForkedWorker:
        try:
            with self._log_path.open("ab") as log:
                if copy is not None:
                    with suppress(BrokenPipeError):  # it has ended
                        copy.become(self._arguments, self._log_path, self._environment)
                        return copy
                    copy.stdin.close()
                    copy.wait()
                return subprocess.Popen(
                    [sys.executable, "-m", *self._arguments],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, **self._environment},
                    # Ctrl-C at the terminal is the bench's to handle: it needs the drives to stop them.
                    start_new_session=True,
                    pass_fds=self._pass_fds,
                )
        except OSError as error:
            raise BenchFaultError(f"{self.name} cannot be started ({error.strerror}), log {self._log_path}") from error

    def restart(self) -> None:
        """Start it again after it has ended. Raises BenchFaultError when the system refuses."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process = self._start()

    def wait_until_prepared(self) -> None:
        """Wait until it has loaded its modules, if it is a copy."""
        if isinstance(self._process, ForkedWorker):
            self._process.wait_until_prepared()

    @property
    def ended(self) -> bool:
        """True if it has ended by itself, or was killed."""
        return self._process.poll() is not None

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def wait(self) -> int:
        """Wait until it ends by itself; returns its exit code."""
        return self._process.wait()

    def check(self) -> None:
        """Raise BenchFaultError with its last words when it has ended."""
        code = self._process.poll()
        if code is not None:
            raise BenchFaultError(f"{self.name} ended by itself (exit code {code}): {self.last_words()}")

    def end(self) -> None:
        """Terminate it, kill it if it does not end; then `lost_frames` is known if it ended in order."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()
        output_tail = self.last_words()
        if output_tail.startswith(_LOST_FRAMES) and output_tail.removeprefix(_LOST_FRAMES).strip().isdecimal():
            self.lost_frames = int(output_tail.removeprefix(_LOST_FRAMES))

    def last_words(self) -> str:
        """The last line of its log."""
        try:
            lines = self._log_path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError as error:
            return f"{self._log_path}: cannot be read ({error.strerror})"
        return lines[-1] if lines else "it printed nothing"


_LOST_FRAMES = "lost frames:"


def report_lost_frames(lost: int | None) -> None:
    """Print the lost frames as the last words of a child that ends in order, from which the bench knows them."""
    print(_LOST_FRAMES, "not known" if lost is None else lost, flush=True)


def log(text: str) -> None:
    """Print into the log of a child."""
    print(text, flush=True)


#: Set in a child's environment: its standard input is a pipe from the bench that closes when the bench ends.
FOLLOW_PARENT = "HILBENCH_FOLLOW_PARENT"


def started_by_bench() -> bool:
    """True in a child that a bench has started, and that ends with the bench."""
    return bool(os.environ.get(FOLLOW_PARENT))


def end_signals() -> list[signal.Signals]:
    """Signals that request the end of a process: SIGINT, SIGTERM, and SIGHUP unless it is ignored (nohup)."""
    asked = [signal.SIGINT, signal.SIGTERM]
    return asked if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else [*asked, signal.SIGHUP]


def leave_terminal() -> None:
    """Discard output from now on, after SIGHUP, where a terminal has closed; writing to it would fail."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        if _leads_to_terminal(descriptor) and not os.isatty(descriptor):
            os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _leads_to_terminal(descriptor: int) -> bool:
    """True for a terminal, also for one that has hung up, for which `isatty` is false."""
    try:
        return os.readlink(f"/proc/self/fd/{descriptor}").startswith(("/dev/pts/", "/dev/tty"))
    except OSError:  # it was closed
        return False


def stop_request() -> Callable[[], bool]:
    """Function for a child that returns true if it is to end (SIGINT, SIGTERM, SIGHUP, or the parent has ended)."""
    requested = threading.Event()

    def request(number: int, _: object) -> None:
        if number == signal.SIGHUP:
            leave_terminal()
        requested.set()

    for number in end_signals():
        signal.signal(number, request)
    if started_by_bench():

        def follow_parent() -> None:
            while os.read(0, 4096):
                pass
            requested.set()

        threading.Thread(target=follow_parent, name="follow-parent", daemon=True).start()
    return requested.is_set


@contextmanager
def _handled_by(handler: Callable[[int, Any], None]) -> Iterator[Mapping[signal.Signals, Any]]:
    """Handle the signals that request the end by this handler meanwhile; yields the previous handlers."""
    before = {number: signal.signal(number, handler) for number in end_signals()}
    try:
        yield before
    finally:
        for number, other in before.items():
            signal.signal(number, other)


@contextmanager
def end_requests() -> Iterator[Callable[[], None]]:
    """Only note the signals that request the end meanwhile; yields a function that raises the first that has come.

    It raises once (KeyboardInterrupt, EndSignal), so that what is left in order afterwards is undisturbed.
    """
    noted: list[int] = []
    raised = False

    def note(number: int, _frame: object) -> None:
        if number == signal.SIGHUP:
            leave_terminal()
        noted.append(number)

    def raise_noted() -> None:
        nonlocal raised
        if noted and not raised:
            raised = True
            raise KeyboardInterrupt if noted[0] == signal.SIGINT else EndSignal(noted[0])

    with _handled_by(note):
        yield raise_noted


class HeldSignals:
    """Handler of the signals that request the end of the process, while something is finished.

    `asked`: the last that is still to act, set to None by the code that acts on it.
    """

    def __init__(self) -> None:
        self.asked: int | None = None
        self._doing: list[tuple[str, float, Callable[[], bool]]] = []

    def __call__(self, number: int, _frame: object) -> None:
        """Print what is finished first; straight to the descriptor, as the stream may be in the middle of a write."""
        if number == signal.SIGHUP:
            leave_terminal()
        what, began_s, at_once = self._doing[-1]
        if at_once():
            return
        self.asked = number
        elapsed_s = time.monotonic() - began_s
        text = f"{signal.Signals(number).name} waits: {what} (for {elapsed_s:.1f} s until now), then it acts"
        with suppress(OSError):
            os.write(2, f"hilbench: {text}\n".encode())

    @contextmanager
    def doing(self, what: str, at_once: Callable[[], bool]) -> Iterator[HeldSignals]:
        """Set the work that a signal waits for meanwhile."""
        self._doing.append((what, time.monotonic(), at_once))
        try:
            yield self
        finally:
            self._doing.pop()


@contextmanager
def finishing(what: str, at_once: Callable[[], bool] = lambda: False) -> Iterator[HeldSignals]:
    """Hold the signals that request the end of the process: each reports what it waits for, and acts afterwards.

    `at_once`: acts on one now, or returns false to hold it. One inside another holds them until the outer is done;
    in a thread other than the main one nothing is held.
    """
    outer = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    held = outer if main and isinstance(outer, HeldSignals) else HeldSignals()
    handled: AbstractContextManager[Mapping[signal.Signals, Any]] = nullcontext({})
    if main and held is not outer:
        handled = _handled_by(held)
    with handled as before, held.doing(what, at_once):
        yield held
    if before and held.asked is not None:
        handler = before[signal.Signals(held.asked)]
        (handler if callable(handler) else signal.default_int_handler)(held.asked, None)
