"""Copies of this process that become the other processes of a bench: imported modules need not be imported again.

They are forked while no other thread runs in this process, share nothing with it but its memory (a session of their
own, no open file, no signal handler), prepare themselves while it continues, and wait. The program that one becomes
then runs as by ``python -m``: the same command line, the same streams, the same exit code. One that is not needed
ends, also when this process is killed.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import runpy
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import TimeoutExpired
from typing import IO, NoReturn

from hilbench.crash_report import crash_report
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED

#: Called in a copy before it waits.
Preparation = Callable[[], object]

_LONGEST_ORDER = 1 << 16
# <sys/prctl.h>
_PR_SET_NAME, _PR_SET_MM, _PR_SET_MM_MAP = 15, 35, 14
#: Fields of /proc/self/stat (proc(5)) behind the name: the bounds of what a `struct prctl_mm_map` begins with.
_START_CODE, _END_CODE, _START_STACK = 26 - 3, 27 - 3, 28 - 3
_START_DATA, _END_DATA, _START_BRK, _ARG_START, _ENV_START, _ENV_END = (field - 3 for field in (45, 46, 47, 48, 50, 51))


class ForkedWorker:
    """One copy: it waits for `become`; from then on it is a process as `subprocess.Popen` has it."""

    def __init__(self, pid: int, order: IO[bytes], reports: IO[bytes]) -> None:
        self.pid = pid
        self._reports = reports
        self.returncode: int | None = None
        #: Its standard input; its end of file signals to the program that this process has ended.
        self.stdin = order
        self._end = os.pidfd_open(pid)

    def become(self, arguments: Sequence[str], log: Path, environment: Mapping[str, str]) -> None:
        """Run the module and arguments after ``python -m`` in `arguments`; its output is added to `log`.

        `environment`: variables in addition to those of this process. Raises OSError when it has ended.
        """
        order = json.dumps([list(arguments), str(log.absolute()), dict(environment)])
        self.stdin.write(order.encode() + b"\n")

    def wait_until_prepared(self) -> None:
        """Wait until its preparation is over, also where that has failed, or the copy has ended."""
        if not self._reports.closed:
            self._reports.read()

    def poll(self) -> int | None:
        """Exit code, negative: the signal that ended it; None: it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._ended(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end. Raises TimeoutExpired after `timeout` s."""
        if self.returncode is None:
            if timeout is not None and not _readable(self._end, timeout):
                raise TimeoutExpired(str(self.pid), timeout)
            self._ended(os.waitpid(self.pid, 0)[1])
        assert self.returncode is not None
        return self.returncode

    def terminate(self) -> None:
        """SIGTERM."""
        self._signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL."""
        self._signal(signal.SIGKILL)

    def _signal(self, number: int) -> None:
        if self.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)  # the id is not reused before it was waited for

    def _ended(self, status: int) -> None:
        self.returncode = os.waitstatus_to_exitcode(status)
        os.close(self._end)
        self._reports.close()


def _readable(descriptor: int, timeout_s: float) -> bool:
    poll = select.poll()  # takes any number, as `select` does not
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(1e3 * timeout_s))


@contextmanager
def forked_workers(preparations: Mapping[str, Preparation]) -> Iterator[dict[str, ForkedWorker]]:
    """Copies of this process as it is now, by name; take them from the dictionary. Those left in it end on leaving.

    Each calls its preparation before it waits, to load what it will need. That must change
    nothing outside of the process; an exception in it is ignored, and left to the program that the copy becomes.
    None where other threads run (their locks would stay locked in a copy), and none where this process has
    its modules from an importer by which nothing can be run, as under pytest.
    """
    made: dict[str, ForkedWorker] = {}
    try:
        if threading.active_count() == 1 and hasattr(__spec__.loader, "get_code"):
            with suppress(OSError):  # the system has no room for one: starting a new interpreter will report that
                for name, prepare in preparations.items():
                    made[name] = _fork(prepare)
        yield made
    finally:
        for copy in made.values():
            copy.stdin.close()
        for copy in made.values():
            copy.wait()


def _fork(prepare: Preparation) -> ForkedWorker:
    (receives, sends), (receives_reports, reports) = os.pipe2(os.O_CLOEXEC), os.pipe2(os.O_CLOEXEC)
    try:
        # A signal in between would be handled by this process' handlers in both.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            pid = os.fork()
            if pid == 0:
                _wait_for_order(receives, reports, before, prepare)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    except OSError:
        os.close(sends)
        os.close(receives_reports)
        raise
    finally:
        os.close(receives)
        os.close(reports)
    return ForkedWorker(pid, os.fdopen(sends, "wb", buffering=0), os.fdopen(receives_reports, "rb", buffering=0))


def _wait_for_order(receives: int, reports: int, signals: Iterable[int], prepare: Preparation) -> NoReturn:
    """Run the life of a copy; it never returns to the caller of `_fork`."""
    code, has_left = EXIT_BENCH_FAULT, False
    try:
        os.setsid()  # Ctrl-C at the terminal is the bench's to handle
        gc.freeze()  # what was there before stays: whatever it would do at its end is the other process' to do
        _leave_files(receives, reports)
        has_left = True
        _leave_handlers()
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        with suppress(Exception):
            prepare()
        _lead_nowhere(reports)  # who reads at the other end finds nothing there
        order = _read_order()
        code = 0 if order is None else _become(*json.loads(order))
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    except BaseException as error:
        with suppress(BaseException):
            if has_left:  # else standard error is not its own
                print(f"hilbench: {error!r}", file=sys.stderr, flush=True)
    finally:
        os._exit(code)


def _lead_nowhere(descriptor: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
    os.dup2(nowhere, descriptor, inheritable=False)
    os.close(nowhere)


def _leave_files(receives: int, reports: int) -> None:
    """Keep `receives`, as standard input, and `reports`. The numbers of all others lead nowhere, but stay taken: an
    object of before that closes its own does not close one of ours."""
    nowhere = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
    for descriptor in map(int, os.listdir("/proc/self/fd")):
        if descriptor not in (nowhere, receives, reports):
            with suppress(OSError):  # that of the listing is closed already
                os.fstat(descriptor)
                os.dup2(nowhere, descriptor, inheritable=descriptor <= 2)
    os.dup2(receives, 0)
    os.dup2(nowhere, receives, inheritable=False)
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False, errors="backslashreplace")


def _leave_handlers() -> None:
    """Reset signal handlers to those of a new interpreter; ignored signals stay ignored."""
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _read_order() -> bytes | None:
    """None: there is none to come."""
    order = b""
    while not order.endswith(b"\n"):
        some = os.read(0, _LONGEST_ORDER)
        if not some:
            return None
        order += some
    return order


def _become(arguments: list[str], log: str, environment: dict[str, str]) -> int:
    """Run a module as ``python -m`` does; its exit code."""
    written = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o666)
    for descriptor in (1, 2):
        os.dup2(written, descriptor)
    os.close(written)
    os.environ.update(environment)
    read_by_kernel = _call_itself([sys.executable, "-m", *arguments])
    module, sys.argv, code = arguments[0], list(arguments), 0
    if not hasattr(sys.modules.get(module), "__path__"):
        sys.modules.pop(module, None)  # it is run, not imported
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except Exception as error:  # unexpected
        print(f"hilbench: {crash_report(error)}", file=sys.stderr)
        code = EXIT_BENCH_FAULT
    sys.stdout.flush()
    sys.stderr.flush()
    del read_by_kernel
    return code


class _Bounds(ctypes.Structure):
    """``struct prctl_mm_map`` of <linux/prctl.h>."""

    _fields_ = (
        *((name, ctypes.c_uint64) for name in (
            "start_code", "end_code", "start_data", "end_data", "start_brk", "brk", "start_stack",
            "arg_start", "arg_end", "env_start", "env_end", "auxv",
        )),
        ("auxv_size", ctypes.c_uint32),
        ("exe_fd", ctypes.c_uint32),
    )  # fmt: skip


def _call_itself(words: Sequence[str]) -> ctypes.Array[ctypes.c_char]:
    """Have these words in /proc/PID/cmdline, and the program's name for `ps` and `pkill`, as if started with them.

    They have to be kept: the kernel reads them where they are. One without CONFIG_CHECKPOINT_RESTORE leaves those of
    before.
    """
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_NAME, os.path.basename(words[0]).encode()[:15], 0, 0, 0)
    text = b"\0".join(word.encode() for word in words) + b"\0"
    kept = ctypes.create_string_buffer(text, len(text))
    fields = [int(word) for word in Path("/proc/self/stat").read_text().rpartition(")")[2].split()[1:]]
    at = dict(enumerate(fields, 1))
    libc.sbrk.restype = ctypes.c_void_p
    start = ctypes.addressof(kept)
    bounds = _Bounds(
        start_code=at[_START_CODE],
        end_code=at[_END_CODE],
        start_data=at[_START_DATA],
        end_data=at[_END_DATA],
        start_brk=at[_START_BRK],
        brk=libc.sbrk(0),
        start_stack=at[_START_STACK],
        arg_start=start,
        arg_end=start + len(text),
        env_start=at[_ENV_START],
        env_end=at[_ENV_END],
        exe_fd=0xFFFFFFFF,
    )
    libc.prctl(_PR_SET_MM, _PR_SET_MM_MAP, ctypes.byref(bounds), ctypes.sizeof(bounds), 0)
    return kept
