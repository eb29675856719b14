"""SYNC at absolute deadlines without the interpreter: one compiled loop, for a thread of its own.

It calls clock_gettime(2), clock_nanosleep(2), prctl(2) and send(2) of the C library of the process.
Bench and loop exchange state in one record, each field of which one of the two writes.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, NamedTuple

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
from hilbench.compiled import COUNT, TABLE, Wholes, arrays_in, entry_point, record_type

#: Written by the loop: SYNCs sent, when the next is due (ns of the monotonic clock), periods without one: the loop woke
#: late, the bus did not take it, or it was not to go out. Written by the bench: end flag, and the last SYNC, by number,
#: that may go out.
SHARED = record_type("sent", "deadline_ns", "without", "end", "last", of=np.int64)
#: So many SYNCs back it is known how late each was.
REMEMBERED: Final = 4096

_SECOND_NS = 1_000_000_000


class Producing(NamedTuple):
    """What bench and loop share; lateness of the SYNCs by number; room for a timespec of the kernel; the packet."""

    shared: Annotated[Any, SHARED]
    lateness_ns: Wholes
    timespec: Wholes
    packet: Wholes


#: produce(period in ns, descriptor of the bus, table of a `Producing`, length of its packet in bytes)
@entry_point(COUNT, COUNT, TABLE, COUNT)
def produce(period_ns: int, descriptor: int, table: NDArray[np.int64], length: int) -> None:
    """Send the packet at each deadline until the end is set.

    A period for which the loop was not woken is skipped and counted; no deadline is ever moved. After the last SYNC
    allowed it waits until the bench allows more.
    """
    a = arrays_in(table, Producing)
    shared, timespec = a.shared, a.timespec
    time = timespec.ctypes.data
    if shared.end == 0:
        prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)  # else the kernel may wake it 50 µs late to save energy
    while shared.end == 0:
        deadline_ns = shared.deadline_ns
        timespec[0], timespec[1] = deadline_ns // _SECOND_NS, deadline_ns % _SECOND_NS
        while clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, time, 0) != 0:
            pass  # a signal
        if shared.end != 0:
            return
        clock_gettime(CLOCK_MONOTONIC, time)
        late_ns = timespec[0] * _SECOND_NS + timespec[1] - deadline_ns
        over = late_ns // period_ns
        shared.without += over
        shared.deadline_ns = deadline_ns + (1 + over) * period_ns
        if shared.sent >= shared.last:
            shared.without += 1
            continue
        a.lateness_ns[shared.sent % REMEMBERED] = late_ns
        shared.sent += 1  # before it is out: no receiver gets one that is not counted
        if send(descriptor, a.packet.ctypes.data, length, MSG_DONTWAIT | MSG_NOSIGNAL) != length:
            shared.sent -= 1
            shared.without += 1
