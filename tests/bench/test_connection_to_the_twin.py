"""When a twin is lost, asked to come back, and taken back: the bench's side alone, on nodes and cycles of the test."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest
from tests.bench.samples import sample_of_two_axes

from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.bench.tasks import twin_connection
from hilbench.bench.tasks.twin_connection import TwinConnection
from hilbench.errors import BenchFaultError

TWIN = "virtual io (node 32)"


class AtOnce:
    """In place of the pool's thread: what is asked for has been done when `submit` returns."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def submit(self, work: Callable[[], None]) -> Future[None]:
        done: Future[None] = Future()
        try:
            work()
        except BenchFaultError as error:
            done.set_exception(error)
        else:
            done.set_result(None)
        return done

    def shutdown(self, *, wait: bool) -> None:
        pass


@dataclass
class Nodes:
    """The twin's nodes as the connection sees them; `answers`: whether a reset of them succeeds."""

    exchange: Exchange
    answers: bool = True
    twin_name: str = TWIN
    twin_problem: str = ""
    twin_alive: bool = False
    twin_reported_cycle: int = 0
    counted: int = 0
    held_up_cycles: int = 0
    asked: list[int] = field(default_factory=list)

    def restart_twin(self) -> None:
        self.asked.append(self.exchange.timing.cycles)
        if not self.answers:
            raise BenchFaultError("no answer from virtual io (node 32)")

    def twin_is_away(self) -> None:
        self.twin_problem, self.twin_alive = "", False

    def twin_is_back(self) -> None:
        self.twin_problem = ""

    def twin_age(self, syncs: int) -> int:
        return self.held_up_cycles

    def twin_started(self, syncs: int) -> int:
        return syncs - self.counted


@dataclass
class Exchange:
    """The cycles."""

    in_step: bool
    timing: Any = field(default_factory=lambda: SimpleNamespace(cycles=1))
    silent: set[str] = field(default_factory=set)
    twin_expected_since: int | None = 0  # None: it is not waited for
    stood_still: int = 0

    def expect_all(self, twin_since: int) -> None:
        self.silent.discard(TWIN)
        self.twin_expected_since = twin_since

    def expect_drives(self) -> None:
        self.twin_expected_since = None

    def stand_still(self, until: Future[None], most_s: float) -> None:
        self.stood_still += 1

    def discard_waiting(self) -> None:
        pass


@dataclass
class Process:
    """The twin's process."""

    ended: bool = False
    starts: int = 0

    def restart(self) -> None:
        self.starts += 1


class Bench:
    """A connection in its cycles. `changes` and `said`: what it notes."""

    def __init__(self, *, lockstep: bool, process: Process | None = None) -> None:
        self.exchange = Exchange(in_step=lockstep)
        self.nodes = Nodes(self.exchange)
        self.changes: list[Change] = []
        self.said: list[str] = []
        self.state = BenchState(0.002, sample_of_two_axes(), self.said.append, self.changes.append)
        self.connection = TwinConnection(
            self.state,
            self.nodes,  # type: ignore[arg-type]
            self.exchange,  # type: ignore[arg-type]
            process,  # type: ignore[arg-type]
            age_limit_cycles=10,
        )

    def cycles(self, count: int = 1) -> None:
        for _ in range(count):
            self.connection.before(self.state.sample, {})
            self.exchange.timing.cycles += 1

    @property
    def away(self) -> bool:
        return self.state.twin.away


@pytest.fixture(autouse=True)
def _no_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin_connection, "ThreadPoolExecutor", AtOnce)


@pytest.fixture
def bench() -> Bench:
    return Bench(lockstep=True)


def test_a_twin_that_answers_is_left_alone(bench: Bench) -> None:
    bench.cycles(2000)
    assert not bench.away
    assert bench.nodes.asked == []
    assert bench.changes == []


def lose(bench: Bench) -> None:
    bench.exchange.silent.add(TWIN)


def leave_operational(bench: Bench) -> None:
    bench.nodes.twin_problem = "virtual axis1 (node 17) has left OPERATIONAL"


@pytest.mark.parametrize(
    ("happens", "why"), [(lose, "does not answer SYNC"), (leave_operational, "node 17) has left OPERATIONAL")]
)
def test_a_lost_twin_is_waited_for_no_longer(bench: Bench, happens: Callable[[Bench], None], why: str) -> None:
    bench.cycles(9)
    happens(bench)
    bench.cycles()
    assert bench.away
    assert why in bench.state.twin.why
    assert bench.exchange.twin_expected_since is None
    assert [(change.cycle, change.what) for change in bench.changes] == [(10, "twin_lost")]


def test_in_lockstep_a_twin_that_is_heard_again_is_back_in_the_same_cycle(bench: Bench) -> None:
    lose(bench)
    bench.cycles()
    bench.nodes.twin_alive = True
    bench.cycles()
    assert not bench.away
    assert bench.exchange.stood_still == 1
    assert bench.exchange.twin_expected_since == 2
    assert not bench.state.twin.fresh(sample_of_two_axes(cycle=2))  # a sample from before it was taken back
    assert bench.state.twin.fresh(sample_of_two_axes(cycle=3))
    assert [change.what for change in bench.changes] == ["twin_lost", "twin_back"]


def test_by_the_clock_it_is_back_once_it_has_told_which_syncs_it_counts() -> None:
    bench = Bench(lockstep=False)
    lose(bench)
    bench.cycles()
    bench.nodes.twin_alive = True
    bench.cycles(20)
    assert bench.away
    assert bench.exchange.stood_still == 0
    bench.nodes.twin_reported_cycle, bench.nodes.counted = bench.exchange.timing.cycles, 4
    bench.cycles()
    assert not bench.away
    assert bench.state.twin.started_cycle == bench.nodes.twin_reported_cycle - 4


def test_one_that_was_started_and_tells_nothing_is_asked_again() -> None:
    bench = Bench(lockstep=False)
    lose(bench)
    bench.cycles()
    bench.nodes.twin_alive = True
    bench.cycles(110)
    assert bench.away
    assert any("reports nothing within 100 cycles" in text for text in bench.said)
    bench.cycles(510)
    assert len(bench.nodes.asked) == 2


def test_one_that_is_not_heard_is_asked_every_500_cycles_and_then_ever_more_seldom(bench: Bench) -> None:
    bench.nodes.answers = False
    lose(bench)
    bench.cycles(12_000)
    asked = bench.nodes.asked
    waits = [round((later - earlier) / 500) for earlier, later in pairwise(asked)]
    assert waits[:2] == [1, 1]
    assert waits == sorted(waits)
    assert waits[-1] >= 8
    assert bench.away
    assert any("did not come back: no answer from virtual io" in text for text in bench.said)


def test_a_process_that_has_ended_is_started_again_three_times_at_most() -> None:
    process = Process()
    bench = Bench(lockstep=True, process=process)
    bench.cycles(200)
    process.ended = True
    bench.cycles(2000)
    assert bench.away
    assert process.starts == 3
    assert any("started again (1 of 3)" in text for text in bench.said)


def test_a_reset_on_purpose_is_under_way_until_it_is_back() -> None:
    bench = Bench(lockstep=False)
    bench.connection.reset()
    assert bench.connection.returning
    bench.cycles(5)
    bench.nodes.twin_reported_cycle = bench.exchange.timing.cycles
    bench.cycles()
    assert not bench.connection.returning
    assert not bench.away


def test_a_reset_on_purpose_that_fails_is_a_fault(bench: Bench) -> None:
    bench.nodes.answers = False
    with pytest.raises(BenchFaultError, match="no answer from virtual io"):
        bench.connection.reset()
    assert not bench.connection.returning


def test_answers_that_are_late_by_ever_more_cycles_are_no_other_count(bench: Bench) -> None:
    for held_up in range(300):
        bench.nodes.held_up_cycles = held_up
        bench.cycles()
    assert not bench.away


def test_a_twin_whose_count_has_jumped_and_stays_is_lost(bench: Bench) -> None:
    bench.cycles(10)
    bench.nodes.held_up_cycles = 5000
    bench.cycles(99)
    assert not bench.away
    bench.cycles(3)
    assert bench.away
    assert "counts SYNC anew" in bench.state.twin.why
