"""SYNC by the wall clock from a thread without the interpreter: a bench that is held up delays no SYNC.

It has its own connection to the bus, so that the bench receives each SYNC in its place between the others' frames:
what is before it and what is after. Where the bench does not run for `LONGEST_ALONE_S` no SYNC goes out any more,
until it runs again: nodes without set points enter their safe state by their own time-outs, as they do when
the bench's process has ended. Bench and loop exchange state in one record, each field of which one of the two writes.
"""

from __future__ import annotations

import os
import threading
import time
from array import array
from contextlib import suppress
from functools import partial
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
from hilbench.can.frame import Frame
from hilbench.can.link import PacketLink
from hilbench.canopen.identifiers import SYNC
from hilbench.compiled import COUNT, TABLE, Wholes, arrays_in, entry_point, record_type, table_of
from hilbench.errors import BusError

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


#: Longest time SYNC continues without the bench: some of its garbage collections, but less than heartbeat time-outs.
LONGEST_ALONE_S = 0.1
#: A bus that takes no SYNC for this time is lost.
_LOST_S = 1.0


class SyncProducer:
    """Sends SYNC every `period_ns` over `link`, which is its own, from `start` to `close`.

    `sent` counts them.
    """

    def __init__(self, link: PacketLink, period_ns: int) -> None:
        self.period_ns = period_ns
        self._link = link
        link.set_filters([])
        packet = link.packet(Frame(SYNC, b""))
        in_words = np.frombuffer(packet.ljust(-(-len(packet) // 8) * 8, b"\0"), np.int64).copy()
        shared, self._lateness_ns = np.zeros(1, SHARED), np.zeros(REMEMBERED, np.int64)
        self._shared = shared[0]
        self._arrays = Producing(shared, self._lateness_ns, np.zeros(2, np.int64), in_words)
        #: SYNCs that go out behind a `go_on`: the one that the bench then waits for, and those without it.
        self._alone = 1 + max(1, min(REMEMBERED // 2, round(LONGEST_ALONE_S * 1e9 / period_ns)))
        self._lateness_read = 0  # number of them already read
        self._loop = partial(produce, period_ns, link.fileno(), table_of(self._arrays), len(packet))
        self._shared["end"] = 1
        self._loop()  # loads the machine code
        self._shared["end"] = 0
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Send the first SYNC one period from now. Call it in the thread that it is to have priority over."""
        self._shared["deadline_ns"] = time.monotonic_ns() + self.period_ns
        self._shared["last"] = self._alone
        self._thread = threading.Thread(target=self._run, name="sync", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        policy, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
        if policy in (os.SCHED_FIFO, os.SCHED_RR):  # the bench's, which would keep it waiting on the same core
            highest = os.sched_get_priority_max(policy)
            with suppress(PermissionError):
                os.sched_setscheduler(0, policy, os.sched_param(min(priority + 1, highest)))
        self._loop()

    @property
    def is_running(self) -> bool:
        """True if it was started."""
        return self._thread is not None

    @property
    def sent(self) -> int:
        """Number of SYNCs sent."""
        return int(self._shared["sent"])

    @property
    def next_ns(self) -> int:
        """Time at which the next SYNC is due, in ns of the monotonic clock."""
        return int(self._shared["deadline_ns"])

    @property
    def without(self) -> int:
        """Periods without SYNC: the machine did not wake the thread, the bus took none, or the bench was not there."""
        return int(self._shared["without"])

    def go_on(self) -> None:
        """Allow SYNCs for another `LONGEST_ALONE_S` from now: the bench is alive."""
        self._shared["last"] = self._shared["sent"] + self._alone

    def read_lateness(self, to: array[int]) -> None:
        """Append how late each SYNC was (ns) of those that were sent since the last call."""
        sent = self.sent
        for number in range(max(self._lateness_read, sent - REMEMBERED), sent):
            to.append(int(self._lateness_ns[number % REMEMBERED]))
        self._lateness_read = sent

    def check(self, waited_s: float) -> None:
        """Raise BusError when a SYNC due for `waited_s` has not gone out, or the controller is bus-off."""
        self._link.receive(0.0)
        if waited_s > _LOST_S:
            raise BusError(f"{self._link.channel}: took no SYNC for {_LOST_S:g} s")

    def close(self) -> None:
        """Stop sending SYNC. Calling it twice is no error."""
        self._shared["end"] = 1
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._link.close()
