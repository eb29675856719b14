"""What the hub's compiled forwarding works on, in memory that another process can have as well: see `loan`.

Whoever works on it holds its lock, for microseconds; a lock that a killed process held is free again (a robust mutex of
pthread_mutexattr_setrobust(3)). Nobody waits for it in compiled code.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import time
from math import prod

import numpy as np

from hilbench.can import forwarding_kernel as kernel
from hilbench.can import protocol

#: Who hears a frame is told by the bits of a number.
MAX_STATIONS = 62
#: For a pthread_mutex_t, in words of 8 bytes: 40 or 48 bytes, as the machine has it.
_LOCK_WORDS = 16
_SHAPES = {
    "lock": (_LOCK_WORDS,),
    "state": (kernel.OF_STATE,),
    "stations": (MAX_STATIONS, kernel.OF_STATION),
    "known": (kernel.KNOWN_ROWS, kernel.OF_FRAME),
    "received": (kernel.MAX_READY, kernel.PACKET_WORDS),
    "packets": (kernel.MAX_READY, kernel.OF_PACKET),
    "rows": (kernel.MAX_READY, protocol.MAX_RECORDS),
    "carried": (kernel.MAX_CARRIED, kernel.OF_CARRIED),
}
_BYTES = 8 * sum(map(prod, _SHAPES.values()))
# <pthread.h>
_PROCESS_SHARED, _ROBUST = 1, 1
_ATTRIBUTES_BYTES = 64
_PAUSE_S = 20e-6


class WireMemory:
    """Arrays of int64, all 0 in new memory: of each what `forwarding_kernel` says."""

    def __init__(self, descriptor: int) -> None:
        """Raises OSError where the descriptor is of no such memory."""
        memory = mmap.mmap(descriptor, _BYTES)
        arrays, at = {}, 0
        for name, shape in _SHAPES.items():
            arrays[name] = np.frombuffer(memory, np.int64, prod(shape), at).reshape(shape)
            at += 8 * prod(shape)
        self.lock, self.state, self.stations = arrays["lock"], arrays["state"], arrays["stations"]
        self.known, self.received, self.packets = arrays["known"], arrays["received"], arrays["packets"]
        self.rows, self.carried = arrays["rows"], arrays["carried"]
        self._library = ctypes.CDLL(None)

    def make_lock(self) -> None:
        """For the one who has made the memory."""
        attributes, library = ctypes.create_string_buffer(_ATTRIBUTES_BYTES), self._library
        library.pthread_mutexattr_init(attributes)
        library.pthread_mutexattr_setpshared(attributes, _PROCESS_SHARED)
        library.pthread_mutexattr_setrobust(attributes, _ROBUST)
        library.pthread_mutex_init(ctypes.c_void_p(self.lock.ctypes.data), attributes)
        library.pthread_mutexattr_destroy(attributes)

    def hold(self, timeout_s: float) -> bool:
        """Whether the lock is held now; a holder that was killed has let it go."""
        lock, until_s = ctypes.c_void_p(self.lock.ctypes.data), time.monotonic() + timeout_s
        while (outcome := self._library.pthread_mutex_trylock(lock)) == errno.EBUSY:
            if time.monotonic() > until_s:
                return False
            time.sleep(_PAUSE_S)
        if outcome == errno.EOWNERDEAD:
            self._library.pthread_mutex_consistent(lock)
        return outcome in (0, errno.EOWNERDEAD)

    def release(self) -> None:
        """Whoever holds it."""
        self._library.pthread_mutex_unlock(ctypes.c_void_p(self.lock.ctypes.data))


def new_memory() -> int:
    """The descriptor of memory for these arrays: without a name, so that only who is given it can have it."""
    descriptor = os.memfd_create("hilbench-wire")
    os.ftruncate(descriptor, _BYTES)
    return descriptor
