"""Work in slices: a process that computes for long leaves its core to nobody for a while behind each of them.

Where every core is busy all the time a machine that has only a share of another one (a virtual machine, a container
with a quota) has used it up before its period of 100 ms is over, and stands still until then: also for those that come
first. Nothing on this side can come before that but to use less.

Machine code does not come back to the interpreter for seconds, so that the rest is taken where a signal finds it.
"""

from __future__ import annotations

import ctypes
import signal
from typing import Final

import numba
import numpy as np
from numba import types

from hilbench.c_library import CLOCK_MONOTONIC, clock_nanosleep

#: CPU time of a slice, and the rest behind it, s: two thirds of a core, at most.
WORK_S: Final = 0.02
REST_S: Final = 0.01

_REST = np.array([0, round(REST_S * 1e9)], np.int64)


@numba.cfunc(types.void(types.int32))
def _rest(_: int) -> None:
    """What a handler of signals may call: nothing is allocated, and nothing of the interpreter's is touched."""
    clock_nanosleep(CLOCK_MONOTONIC, 0, _REST.ctypes.data, 0)


def throttle_cpu() -> None:
    """From here on the process rests for `REST_S` behind each `WORK_S` of CPU time (SIGPROF, which is taken for it)."""
    libc = ctypes.CDLL(None)
    libc.signal.restype = ctypes.c_void_p
    libc.signal(int(signal.SIGPROF), ctypes.c_void_p(_rest.address))
    signal.setitimer(signal.ITIMER_PROF, WORK_S, WORK_S)
