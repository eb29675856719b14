"""Real-time settings of a process in the operating system and in Python, so that a cycle does not have to wait."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

#: Nice value of the session's group (sched(7)): where the kernel groups by session, those of processes mean nothing.
_AUTOGROUP = Path("/proc/self/autogroup")
_LOWEST = 19
#: Longest time for which a thread keeps the interpreter from a cycle, s: a twentieth of the shortest cycles.
_SWITCH_S = 5e-5

# <asm-generic/mman.h>
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
# <linux/prctl.h>
_PR_SET_THP_DISABLE, _PR_GET_THP_DISABLE = 41, 42


@contextmanager
def for_good() -> Iterator[None]:
    """Keep imports and objects made inside for the life of the process: the garbage collector does not run
    meanwhile, and never scans them again."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()


@dataclass(frozen=True)
class ProcessSettings:
    """Settings of one process; None: unchanged (`lock_memory`: where it is permitted)."""

    priority: int | None = None  #: of SCHED_FIFO, 1 to 99
    core: int | None = None
    lock_memory: bool | None = None


@contextmanager
def kept_ready(settings: ProcessSettings | None, report: Callable[[str], None]) -> Iterator[None]:
    """Run the body, in the calling thread, with the settings; all is as before afterwards.

    A setting that is not permitted is reported, in one line each, and left out. `settings` None (lockstep: no clock is
    waited for): the garbage collector alone, which is off in the loop in any case, and on again after it. Memory
    allocated in a cycle is freed by reference counts; a collection would only scan older objects.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        if settings is None:
            yield
            return
        with (
            _in_small_pages(),
            _pinned(settings.core, report),
            _first(settings.priority, report),
            _locked(settings.lock_memory, report),
        ):
            yield
    finally:
        if collects:
            gc.enable()
            gc.collect()


@contextmanager
def _pinned(core: int | None, report: Callable[[str], None]) -> Iterator[None]:
    if core is None:
        yield
        return
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {core})
    except OSError:
        report(f"core {core}: cannot be had, expected one of {', '.join(map(str, sorted(before)))}")
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def comes_first() -> bool:
    """True if this process has a real-time priority, and so runs before all others as soon as it has work."""
    return os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)


@contextmanager
def _first(priority: int | None, report: Callable[[str], None]) -> Iterator[None]:
    if priority is None:
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        report(f"priority {priority}: SCHED_FIFO is not permitted, rtprio is {limit}; see hilbench doctor")
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


@contextmanager
def _locked(wanted: bool | None, report: Callable[[str], None]) -> Iterator[None]:
    """Lock memory (mlockall(2)): a page that has to come back from disk costs more than a cycle.

    What is allocated later is not locked, so that nothing fails for lack of lockable memory in the middle of a run.
    """
    if wanted is False:
        yield
        return
    libc = ctypes.CDLL(None)
    locked = libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT) == 0
    if wanted and not locked:
        limit_KiB = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] >> 10
        report(f"lock_memory: not permitted, memlock is {limit_KiB} KiB; see hilbench doctor")
    try:
        yield
    finally:
        if locked:
            libc.munlockall()


@contextmanager
def _in_small_pages() -> Iterator[None]:
    """Disable huge pages (prctl(2)) for memory of this process, which numpy enables: the kernel's thread
    that merges them has a core for milliseconds on end, whatever waits for it."""
    libc = ctypes.CDLL(None)
    before = libc.prctl(_PR_GET_THP_DISABLE, 0, 0, 0, 0)
    libc.prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)
    try:
        yield
    finally:
        libc.prctl(_PR_SET_THP_DISABLE, max(before, 0), 0, 0, 0)


def give_way(taken: Collection[int] = (), *, before: int | None = None) -> None:
    """Give way, in a process that may wait: use only idle time of one core from here on, if there is one on none of
    those that are `taken`.

    before: SCHED_FIFO priority of those that it gives way to. Where they have it they come first in any case, and it
    has its share of the rest on all of these cores, as others have: on a machine with other work there may be no
    idle time.
    """
    ctypes.CDLL(None).prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)  # see `_in_small_pages`
    permitted = os.sched_getaffinity(0)
    cores = permitted - set(taken) or permitted
    if before is None or not _may_have(before):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        # A process with a session of its own is in a group of its own, which has the weight of any other.
        with suppress(OSError):
            _AUTOGROUP.write_text(str(_LOWEST), encoding="ascii")
        cores = {max(cores)}
    os.sched_setaffinity(0, cores)


def _may_have(priority: int) -> bool:
    """True if SCHED_FIFO with this priority is permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def right_behind(cycle_priority: int | None) -> None:
    """Run a thread right after the cycle, with whose interpreter it works; `cycle_priority`: SCHED_FIFO priority of the
    cycle. It comes before all programs without a priority: waiting for those with the interpreter's lock
    would hold up the cycle; here the lock is released within `_SWITCH_S`."""
    sys.setswitchinterval(_SWITCH_S)
    if cycle_priority is not None and cycle_priority > 1:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(cycle_priority - 1))


def beside_the_cycle(last: ProcessSettings | None) -> None:
    """Run a thread of a bench that has little to do, on any core; `last`: settings of the last process of the cycle,
    None in lockstep. Taking the interpreter's lock back for a cycle waits until such a thread has run."""
    if last is not None:
        leave_the_cycle()
        right_behind(last.priority)


def leave_the_cycle() -> None:
    """Drop the cycle's priority and core, in a thread that is started from the cycle."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
