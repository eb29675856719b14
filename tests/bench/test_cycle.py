"""The cyclic exchange in lockstep, when a SYNC is on the bus twice."""

from __future__ import annotations

import time
from collections.abc import Sequence

import pytest

from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.errors import BenchFaultError
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle

STATE, SLOW, EVERY = 0x181, 0x281, 10


class NodeLink:
    """A node that answers each SYNC it hears with its count, and every tenth with a second PDO."""

    channel, dropped, controller = "fake0", 0, ControllerState.ERROR_ACTIVE

    def __init__(self, twice: set[int]) -> None:
        self._twice = twice  #: SYNCs of the bench that are on the bus twice
        self._sent = self._received = 0
        self._waiting: list[list[Frame]] = []

    def send(self, frames: Sequence[Frame]) -> None:
        for can_id, _, _ in frames:
            if can_id == 0x080:
                self._sent += 1
                for _ in range(2 if self._sent in self._twice else 1):
                    self._hear()

    def _hear(self) -> None:
        self._received += 1
        count = self._received.to_bytes(2, "little")
        self._waiting.append([Frame(STATE, count), *([Frame(SLOW, count)] if self._received % EVERY == 0 else [])])

    def receive(self, timeout_s: float) -> list[Frame]:
        """Who waits gets the answers to one SYNC, who does not wait all that are there by then."""
        count = 1 if timeout_s > 0.0 else len(self._waiting)
        taken, self._waiting = self._waiting[:count], self._waiting[count:]
        return [frame for answers in taken for frame in answers]

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None: ...

    def fileno(self) -> int:
        return -1

    def close(self) -> None: ...


def test_a_sync_that_is_there_twice_does_not_shift_the_answers() -> None:
    """The second answers are none to the next SYNC, and what comes every tenth SYNC is expected when it comes."""
    link = NodeLink(twice={13, 27, 28})
    exchange = SyncCycle(
        link,
        cycle_ns=2_000_000,
        bitrate=1_000_000,
        lockstep=True,
        expected=[ExpectedPdo(STATE, 1, "node"), ExpectedPdo(SLOW, EVERY, "node")],
        timeout_s=0.05,
        missing_limit=1,
    )
    slow = 0
    for _ in range(80):
        frames = exchange.exchange([])
        slow += sum(frame.can_id == SLOW for frame in frames)
    assert not exchange.silent
    assert slow in (8, 9)
    received = [int.from_bytes(frame.data, "little") for frame in frames if frame.can_id == STATE]
    assert received[-1] == 83


class Tap:
    """What is in the trace; on a disk that is full from a cycle on."""

    def __init__(self, full_from: int = 1 << 30) -> None:
        self.frames: list[Frame] = []
        self.cycles = 0
        self._full_from = full_from

    def write(self, frames: Sequence[Frame]) -> None:
        self.frames += frames

    def end_cycle(self) -> None:
        self.cycles += 1
        if self.cycles == self._full_from:
            raise BenchFaultError("trace.log: the trace cannot be written (No space left on device)")


def exchange_into(tap: Tap) -> SyncCycle:
    return SyncCycle(
        NodeLink(twice=set()),
        cycle_ns=2_000_000,
        bitrate=1_000_000,
        lockstep=True,
        expected=[ExpectedPdo(STATE, 1, "node")],
        timeout_s=0.05,
        missing_limit=1,
        tap=tap,
    )


def test_the_trace_lacks_the_last_answers_at_most_and_has_the_order_of_the_wire() -> None:
    tap = Tap()
    exchange = exchange_into(tap)
    for _ in range(5):
        exchange.exchange([Frame(0x201, b"\x0f\x00")])
    cycle = [0x201, 0x080, STATE]
    assert [frame.can_id for frame in tap.frames] in (5 * cycle, (5 * cycle)[:-1])
    exchange.discard_waiting()
    assert [frame.can_id for frame in tap.frames] == 5 * cycle
    times_ns = [frame.time_ns for frame in tap.frames]
    assert times_ns == sorted(times_ns)


def test_a_trace_that_fails_is_a_fault_and_the_answers_of_that_cycle_are_taken() -> None:
    exchange = exchange_into(Tap(full_from=3))
    for _ in range(3):
        exchange.exchange([])
    with pytest.raises(BenchFaultError, match="No space left"):
        exchange.exchange([])
    assert [frame.data for frame in exchange.exchange([])] == [b"\x05\x00"]


class SlowLink(NodeLink):
    """Its node answers late, and the bench is heard meanwhile."""

    def __init__(self, delay_s: float) -> None:
        super().__init__(twice=set())
        self._delay_s = delay_s
        self.heartbeats = 0

    def send(self, frames: Sequence[Frame]) -> None:
        self.heartbeats += sum(can_id == 0x77F for can_id, _, _ in frames)
        super().send([frame for frame in frames if frame.can_id == 0x080])

    def receive(self, timeout_s: float) -> list[Frame]:
        time.sleep(min(timeout_s, self._delay_s))
        return super().receive(timeout_s)


@pytest.mark.parametrize(("delay_s", "timeout_s", "heartbeats"), [(0.0, 60.0, {1}), (0.04, 0.06, {2, 3, 4})])
def test_slow_cycles_do_not_silence_the_heartbeat(delay_s: float, timeout_s: float, heartbeats: set[int]) -> None:
    """Every 500th cycle has one; where that takes long they are 0.6 time-outs and a cycle apart at most."""
    link = SlowLink(delay_s)
    exchange = SyncCycle(
        link,
        cycle_ns=2_000_000,
        bitrate=1_000_000,
        lockstep=True,
        expected=[ExpectedPdo(STATE, 1, "node")],
        timeout_s=timeout_s,
        missing_limit=1,
        heartbeat=(127, 1000),
    )
    for _ in range(4):
        exchange.exchange([])
    assert link.heartbeats in heartbeats
