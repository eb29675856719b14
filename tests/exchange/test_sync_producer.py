"""SYNC goes out by the clock whatever the bench's interpreter does; what it then does with what has gone by.

Counts, and spacings in periods: how fast the machine is plays no part. The drive is a station that answers each SYNC.
"""

from __future__ import annotations

import ctypes
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import pytest

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.exchange.answers import Tpdo
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle
from hilbench.exchange.sync_producer import LONGEST_ALONE_S, SyncProducer

PERIOD_NS = 20_000_000
RPDO, TPDO = 0x201, 0x181


class Answers:
    """A drive: says after each SYNC, by TPDO, how many SYNCs it has heard and how many set points."""

    def __init__(self, channel: str) -> None:
        self.link = EmbeddedLink(channel, 1_000_000, "real")
        self.heard: list[str] = []
        self.silent_at: set[int] = set()  #: SYNCs that it does not answer
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
                    if len(self.syncs_ns) not in self.silent_at:
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

    def __init__(self, period_ns: int, heartbeat_ms: int) -> None:
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
            missing_limit=1000,
            heartbeat=(127, heartbeat_ms),
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
def running(period_ns: int = PERIOD_NS, heartbeat_ms: int = 0) -> Iterator[Bench]:
    bench = Bench(period_ns, heartbeat_ms)
    try:
        yield bench
    finally:
        bench.close()


def hold_the_interpreter(duration_s: float) -> None:
    """No other thread of this process runs any Python meanwhile: `ctypes.PyDLL` keeps the lock."""
    ctypes.PyDLL(None).usleep(round(1e6 * duration_s))


def counted(bench: Bench) -> bool:
    """Whether what the bench counts as missed is what went by, and no more than that and what was never sent."""
    missed, elapsed_cycles = bench.cycle.pacing.missed, bench.cycle.elapsed_cycles
    return elapsed_cycles <= missed <= elapsed_cycles + bench.producer.without


def test_a_bench_whose_interpreter_is_held_for_three_periods_shifts_no_sync_and_counts_what_went_by() -> None:
    with running() as bench:
        bench.run(10)
        before = bench.producer.sent + bench.producer.without
        hold_the_interpreter(3.5 * PERIOD_NS * 1e-9)
        assert bench.producer.sent + bench.producer.without >= before + 3
        bench.run(10)
        assert bench.cycle.pacing.missed >= 2
        assert counted(bench)
        assert bench.cycle.timing.cycles == 20
        marks = [frame.time_ns for frame in bench.trace.frames if frame.can_id == SYNC]
        assert len(marks) == 20 + bench.cycle.elapsed_cycles, "each is in the trace, once"
        while len(bench.drive.syncs_ns) < len(marks):
            time.sleep(1e-3)
        assert bench.drive.syncs_ns[: len(marks)] == marks, "and on the bus"
        without = bench.producer.without
    # The hold of three periods has moved nothing: as many deadlines as SYNCs, but for those the machine slept over.
    spacings = sorted((later - earlier) / PERIOD_NS for earlier, later in pairwise(marks))
    assert spacings[len(spacings) // 2] == pytest.approx(1.0, rel=0.1)
    assert -1 <= round(sum(spacings)) - len(spacings) <= without + 1


def cycle_of(bench: Bench, read: Tpdo) -> None:
    """One more, of which the bench reads this TPDO."""
    elapsed_cycles = bench.cycle.elapsed_cycles
    [received] = bench.run(1)
    read.begin()
    for at, frame in enumerate(received):
        if frame.can_id == TPDO:
            read.add(frame.data, before_sync=at < bench.cycle.before_sync)
    read.end(bench.cycle.elapsed_cycles - elapsed_cycles)


def test_answers_are_those_to_the_sync_of_their_cycle_also_behind_ones_that_went_by() -> None:
    with running() as bench:
        bench.run(5)
        read = Tpdo(TPDO, 4, 1, "drive")
        for cycle in range(3):
            hold_the_interpreter((0.5 + 2 * cycle) * PERIOD_NS * 1e-9)
            cycle_of(bench, read)
            assert read.surplus == 0, "what came for SYNCs that went by is no second sender's"
        while not read.fits_fast_path:  # until the drive, which was held as well, has caught up
            cycle_of(bench, read)
        assert read.data is not None
        assert int.from_bytes(read.data, "little") == bench.cycle.timing.cycles + bench.cycle.elapsed_cycles


def test_set_points_that_come_behind_their_sync_are_counted_and_its_answers_taken() -> None:
    with running(5 * PERIOD_NS) as bench:
        bench.run(3)
        while bench.producer.sent == 3:
            time.sleep(1e-4)
        bench.run(1)
        pacing = bench.cycle.pacing
        assert (pacing.late_set_points, pacing.missed, bench.cycle.elapsed_cycles) == (1, 0, 0)
        bench.run(1)
        assert pacing.late_set_points == 1
    kinds = ["SYNC" if frame.can_id == SYNC else "set points" for frame in bench.trace.frames if frame.can_id != TPDO]
    assert kinds == ["set points", "SYNC"] * 3 + ["SYNC", "set points"] + ["set points", "SYNC"]


@pytest.mark.parametrize("follow", [True, False], ids=["set points", "commands"])
def test_set_points_that_would_hold_up_the_next_answers_are_left_out_once(follow: bool) -> None:
    """Behind a missing answer, for which it was waited until 0.7 of the cycle, 400 frames have no time any more."""
    for _ in range(5):  # until the machine lets each cycle have its SYNC
        with running(5 * PERIOD_NS) as bench:
            bench.drive.silent_at = {3, 6}
            for _ in range(8):
                bench.cycle.exchange([Frame(RPDO, bytes(8))] * 400, may_be_left_out=follow)
            pacing = bench.cycle.pacing
        if not pacing.missed:
            break
    marks = [at for at, frame in enumerate(bench.trace.frames) if frame.can_id == SYNC]
    kinds = [frame.can_id for frame in bench.trace.frames]
    sent = [kinds[before:at].count(RPDO) for before, at in zip([0, *marks[:-1]], marks, strict=True)]
    assert sent == ([400, 400, 400, 0, 400, 400, 400, 400] if follow else [400] * 8), "and not again so soon"
    assert pacing.late_set_points >= follow


def test_a_bench_that_does_not_come_any_more_gets_no_more_sync_until_it_comes_again() -> None:
    with running() as bench:
        bench.run(5)
        alone = round(LONGEST_ALONE_S * 1e9 / PERIOD_NS)
        while bench.producer.without < 3:
            time.sleep(PERIOD_NS * 1e-9)
        assert bench.producer.sent - 5 <= alone + 1
        bench.run(5)
        assert bench.cycle.timing.cycles == 10
        assert counted(bench)
        assert bench.cycle.pacing.missed >= 3


def test_a_sync_of_somebody_else_is_told_apart_by_its_being_one_too_many() -> None:
    with running() as bench:
        stranger = EmbeddedLink(bench.link.channel, 1_000_000, "real")
        try:
            bench.run(3)
            stranger.send([Frame(SYNC, b"")])
            received = [frame for frames in bench.run(5) for frame in frames]
        finally:
            stranger.close()
        assert sum(frame.can_id == SYNC for frame in received) == 1
        assert counted(bench)


def test_after_its_end_no_sync_goes_out() -> None:
    with running() as bench:
        bench.run(3)
        bench.producer.close()
        bench.producer.close()
        sent = len(bench.drive.syncs_ns), bench.producer.sent
        time.sleep(3 * PERIOD_NS * 1e-9)
        assert (len(bench.drive.syncs_ns), bench.producer.sent) == sent
        assert "sync" not in [thread.name for thread in threading.enumerate()]


def test_heartbeats_come_as_often_when_cycles_are_missed() -> None:
    with running(heartbeat_ms=60) as bench:
        for _ in range(6):
            bench.run(2)
            hold_the_interpreter(2.2 * PERIOD_NS * 1e-9)
        bench.run(1)
        periods = bench.cycle.timing.cycles + bench.cycle.pacing.missed
        said = sum(frame.can_id == 0x77F for frame in bench.trace.frames)
    # One in three periods; it waits for the next cycle, here three periods later at most.
    assert periods / 5 - 1 <= said <= periods / 3 + 1
