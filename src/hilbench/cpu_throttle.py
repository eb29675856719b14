"""CPU duty cycle for background work: a process that computes for long rests after every slice of CPU time.

Where every core is busy all the time a machine with a share of another one (a virtual machine, a container
with a quota) has used it up before its period of 100 ms is over, and is stopped until then: also processes of the
highest priority. The only remedy inside is to use less.

Machine code does not return to the interpreter for seconds, so the rest is taken where a signal interrupts it.
"""

from __future__ import annotations

import ctypes
import signal
from typing import Final

import numba
import numpy as np
from numba import types

from hilbench.c_library import CLOCK_MONOTONIC, clock_nanosleep

#: CPU time of a slice, and the rest after it, s: two thirds of a core, at most.
WORK_S: Final = 0.02
REST_S: Final = 0.01

_REST = np.array([0, round(REST_S * 1e9)], np.int64)


@numba.cfunc(types.void(types.int32))
def _rest(_: int) -> None:
    """Rest in a signal handler: nothing is allocated, and no state of the interpreter is touched."""
    clock_nanosleep(CLOCK_MONOTONIC, 0, _REST.ctypes.data, 0)


def throttle_cpu() -> None:
    """Make the process rest for `REST_S` after each `WORK_S` of CPU time from here on (uses SIGPROF)."""
    libc = ctypes.CDLL(None)
    libc.signal.restype = ctypes.c_void_p
    libc.signal(int(signal.SIGPROF), ctypes.c_void_p(_rest.address))
    signal.setitimer(signal.ITIMER_PROF, WORK_S, WORK_S)
