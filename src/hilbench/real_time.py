"""What a process asks of the operating system, and of Python, so that a cycle does not have to wait."""

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

#: Beside which nice values of a process mean nothing where the kernel groups them by session (sched(7)).
_AUTOGROUP = Path("/proc/self/autogroup")
_LOWEST = 19
#: For which a thread keeps the interpreter from a cycle, s: a twentieth of the shortest cycles.
_SWITCH_S = 5e-5

# <asm-generic/mman.h>
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
# <linux/prctl.h>
_PR_SET_THP_DISABLE, _PR_GET_THP_DISABLE = 41, 42


@contextmanager
def for_good() -> Iterator[None]:
    """What is imported and made inside stays as long as the process: the garbage collector neither looks for what of it
    could go meanwhile, nor looks through it ever again."""
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
    """What one process asks for; None: nothing (`lock_memory`: where it is permitted)."""

    priority: int | None = None  #: of SCHED_FIFO, 1 to 99
    core: int | None = None
    lock_memory: bool | None = None


@contextmanager
def kept_ready(settings: ProcessSettings | None, report: Callable[[str], None]) -> Iterator[None]:
    """Run what is inside, in the calling thread, as the settings ask; everything is as before afterwards.

    What is not permitted is reported, in one line each, and left out. `settings` None (lockstep: nobody waits for a
    clock): the garbage collector alone, which is out of the loop in any case, and comes when that is over. What is
    allocated in a cycle goes by reference counts; a collection would only look through what was there before.
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
    """Whether this process comes before all that have no priority of real time, as soon as there is anything to do."""
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
        report(f"priority {priority}: SCHED_FIFO is not permitted, rtprio is {limit}; hilbench doctor says what to do")
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


@contextmanager
def _locked(wanted: bool | None, report: Callable[[str], None]) -> Iterator[None]:
    """A page that has to come back from disk costs more than a cycle (mlockall(2)).

    What is allocated later is not locked, so that nothing fails for lack of lockable memory in the middle of a run.
    """
    if wanted is False:
        yield
        return
    libc = ctypes.CDLL(None)
    locked = libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT) == 0
    if wanted and not locked:
        limit_KiB = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] >> 10
        report(f"lock_memory: not permitted, memlock is {limit_KiB} KiB; hilbench doctor says what to do")
    try:
        yield
    finally:
        if locked:
            libc.munlockall()


@contextmanager
def _in_small_pages() -> Iterator[None]:
    """Nobody puts memory of this process together to huge pages (prctl(2)), which numpy asks for: the kernel's thread
    that does has a core for milliseconds on end, whoever waits for it."""
    libc = ctypes.CDLL(None)
    before = libc.prctl(_PR_GET_THP_DISABLE, 0, 0, 0, 0)
    libc.prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)
    try:
        yield
    finally:
        libc.prctl(_PR_SET_THP_DISABLE, max(before, 0), 0, 0, 0)


def give_way(taken: Collection[int] = (), *, before: int | None = None) -> None:
    """For a process that may wait: from here on it gets what nobody else wants of one core, if there is one on none of
    those that are `taken`.

    before: SCHED_FIFO priority of those that it gives way to. Where they have it they come first in any case, and it
    has its share of what they leave on all of these cores, as others have: on a machine with other work what nobody
    wants may be nothing.
    """
    ctypes.CDLL(None).prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)  # see `_in_small_pages`
    permitted = os.sched_getaffinity(0)
    cores = permitted - set(taken) or permitted
    if before is None or not _may_have(before):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        # A process that has a session of its own is in a group of its own, which is as good as any other.
        with suppress(OSError):
            _AUTOGROUP.write_text(str(_LOWEST), encoding="ascii")
        cores = {max(cores)}
    os.sched_setaffinity(0, cores)


def _may_have(priority: int) -> bool:
    """Whether SCHED_FIFO with this priority is permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def right_behind(cycle_priority: int | None) -> None:
    """In a thread that works in the interpreter of a cycle with this SCHED_FIFO priority, which does not wait for it:
    it comes right behind the cycle, before all programs without a priority. Whoever waits for those and has the
    interpreter's lock meanwhile would hold up the cycle; here the lock goes over within `_SWITCH_S`."""
    sys.setswitchinterval(_SWITCH_S)
    if cycle_priority is not None and cycle_priority > 1:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(cycle_priority - 1))


def beside_the_cycle(last: ProcessSettings | None) -> None:
    """In a thread of a bench that has little to do, on any core; `last`: of the processes of the cycle that which comes
    last, None in lockstep. Whoever wants the interpreter's lock back for a cycle waits until such a thread has run."""
    if last is not None:
        leave_the_cycle()
        right_behind(last.priority)


def leave_the_cycle() -> None:
    """In a thread that is started from the cycle: the cycle's priority and core are not this one's."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
