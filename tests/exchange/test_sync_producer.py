"""SYNC goes out by the clock whatever the bench's interpreter does; what it then does with what has gone by.

Counts, and spacings in periods: how fast the machine is plays no part. The hardware is a station that answers each
SYNC.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle
from hilbench.exchange.sync_producer import SyncProducer

PERIOD_NS = 20_000_000
RPDO, TPDO = 0x201, 0x181


class Answers:
    """A drive: says after each SYNC, by TPDO, how many SYNCs it has heard and how many set points."""

    def __init__(self, channel: str) -> None:
        self.link = EmbeddedLink(channel, 1_000_000, "real")
        self.heard: list[str] = []
        self.syncs_ns: list[int] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            for frame in self.link.receive(0.05):
                if frame.can_id == SYNC:
                    self.heard.append("SYNC")
                    self.syncs_ns.append(frame.time_ns)
                    self.link.send([Frame(TPDO, len(self.syncs_ns).to_bytes(4, "little"))])
                elif frame.can_id == RPDO:
                    self.heard.append("set points")

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self.link.close()


class Trace:
    """What the bench has put into its trace."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def write(self, frames: list[Frame]) -> None:
        self.frames += frames

    def end_cycle(self) -> None: ...


class Bench:
    """The cyclic path with its producer, and a drive on the other side."""

    def __init__(self, period_ns: int = PERIOD_NS, missing_limit: int = 1000) -> None:
        channel = f"producer{os.getpid()}"
        self.drive = Answers(channel)
        self.link = EmbeddedLink(channel, 1_000_000, "real")
        self.producer = SyncProducer(EmbeddedLink(channel, 1_000_000, "real"), period_ns)
        self.trace = Trace()
        self.cycle = SyncCycle(
            self.link,
            cycle_ns=period_ns,
            bitrate=1_000_000,
            lockstep=False,
            expected=[ExpectedPdo(TPDO, 1, "drive")],
            timeout_s=5.0,
            missing_limit=missing_limit,
            heartbeat=(127, 0),
            tap=self.trace,
            producer=self.producer,
        )

    def run(self, cycles: int) -> list[list[Frame]]:
        return [self.cycle.exchange([Frame(RPDO, bytes(4))]) for _ in range(cycles)]

    def close(self) -> None:
        self.producer.close()
        self.link.close()
        self.drive.close()


@contextmanager
def running(period_ns: int = PERIOD_NS) -> Iterator[Bench]:
    bench = Bench(period_ns)
    try:
        yield bench
    finally:
        bench.close()


def hold_the_interpreter(duration_s: float) -> None:
    """No other thread of this process runs any Python meanwhile: `ctypes.PyDLL` keeps the lock."""
    ctypes.PyDLL(None).usleep(round(1e6 * duration_s))


def numbers(bench: Bench) -> list[int]:
    return [int.from_bytes(frame.data, "little") for frame in bench.trace.frames if frame.can_id == TPDO]
