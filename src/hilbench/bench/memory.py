"""Memory that stays where it is: a page that has to come back from disk costs more than a cycle."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

# <asm-generic/mman.h>
_MCL_CURRENT, _MCL_ONFAULT = 1, 4


@contextmanager
def locked_memory() -> Iterator[bool]:
    """Keep what the process has in memory now from being paged out (mlockall(2)); True if that is allowed.

    It is with ``memlock unlimited`` (RLIMIT_MEMLOCK) or CAP_IPC_LOCK; without, the bench runs all the same. What is
    allocated later is not locked, so that nothing fails for lack of lockable memory in the middle of a run.
    """
    libc = ctypes.CDLL(None)
    locked = libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT) == 0
    try:
        yield locked
    finally:
        if locked:
            libc.munlockall()
