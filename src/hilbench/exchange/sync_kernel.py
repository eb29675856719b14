"""SYNC at absolute deadlines without the interpreter: one compiled loop, for a thread of its own.

It calls clock_gettime(2), clock_nanosleep(2), prctl(2) and send(2) of the C library of the process.
Bench and loop exchange state in one vector, each place of which one of the two writes.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.c_library import (
    CLOCK_MONOTONIC,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    PR_SET_TIMERSLACK,
    TIMER_ABSTIME,
    clock_gettime,
    clock_nanosleep,
    prctl,
    send,
)
from hilbench.compiled import COUNT, INDICES, entry_point

#: Places in the vector. Written by the loop: SYNCs sent, when the next is due (ns of the monotonic clock), periods
#: without one: the loop woke late, the bus did not take it, or it was not to go out.
SENT, DEADLINE_NS, WITHOUT = range(3)
#: Written by the bench: end flag, and the last SYNC, by number, that may go out.
END, LAST = 3, 4
PLACES: Final = 5
#: So many SYNCs back it is known how late each was.
REMEMBERED: Final = 4096

_SECOND_NS = 1_000_000_000

Places = NDArray[np.int64]


#: produce(shared, lateness_ns, timespec, period_ns, descriptor, packet, length)
@entry_point(INDICES, INDICES, INDICES, COUNT, COUNT, INDICES, COUNT)
def produce(
    shared: Places,
    lateness_ns: Places,
    timespec: Places,
    period_ns: int,
    descriptor: int,
    packet: Places,
    length: int,
) -> None:
    """Send `packet` (its first `length` bytes) to `descriptor` at each deadline until END is set.

    `timespec`: room for one of the kernel. A period for which the loop was not woken is skipped and
    counted; no deadline is ever moved. After the last SYNC allowed it waits until the bench allows more.
    """
    time = timespec.ctypes.data
    if shared[END] == 0:
        prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)  # else the kernel may wake it 50 µs late to save energy
    while shared[END] == 0:
        deadline_ns = shared[DEADLINE_NS]
        timespec[0], timespec[1] = deadline_ns // _SECOND_NS, deadline_ns % _SECOND_NS
        while clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, time, 0) != 0:
            pass  # a signal
        if shared[END] != 0:
            return
        clock_gettime(CLOCK_MONOTONIC, time)
        late_ns = timespec[0] * _SECOND_NS + timespec[1] - deadline_ns
        over = late_ns // period_ns
        shared[WITHOUT] += over
        shared[DEADLINE_NS] = deadline_ns + (1 + over) * period_ns
        if shared[SENT] >= shared[LAST]:
            shared[WITHOUT] += 1
            continue
        lateness_ns[shared[SENT] % REMEMBERED] = late_ns
        shared[SENT] += 1  # before it is out: no receiver gets one that is not counted
        if send(descriptor, packet.ctypes.data, length, MSG_DONTWAIT | MSG_NOSIGNAL) != length:
            shared[SENT] -= 1
            shared[WITHOUT] += 1
