"""The bench's connection to its twin: lost when it does not answer, taken back when it is heard again.

The bench can do without its twin: axis 1 follows the ratio of speeds meanwhile (`tension_control`). A twin
that comes back, whether it was held up or its process had to be started again, is reset and configured anew, because
nobody knows what it has missed; the loop closes when it calls itself synchronized.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from math import inf

from hilbench.bench.change import Change
from hilbench.bench.config import BenchConfig
from hilbench.bench.cycle import CyclicExchange
from hilbench.bench.nodes import Nodes
from hilbench.bench.processes import ChildProcess
from hilbench.bench.sample import CycleSample
from hilbench.bench.twin_trust import TwinTrust
from hilbench.errors import BenchFaultError

#: So often the twin's process is started again in one run.
_MOST_STARTS = 3
#: Cycles from an attempt to take the twin back to the next.
_RETRY_CYCLES = 500
#: Cycles between two looks whether the process lives.
_LOOK_CYCLES = 64


class TwinConnection:
    """State of the connection in one run. `process` is None when somebody else started the twin."""

    def __init__(
        self,
        config: BenchConfig,
        nodes: Nodes,
        exchange: CyclicExchange,
        process: ChildProcess | None,
        note: Callable[[str], None],
        journal: Callable[[Change], None],
    ) -> None:
        self._lockstep = config.pace == "lockstep"
        self._nodes = nodes
        self._exchange = exchange
        self._process = process
        self._note = note
        self._journal = journal
        self._trust = TwinTrust(config.tension_control, config.safety.limits.tension_N.trip or inf)
        self._was_closed: bool | None = None  # None before it was closed for the first time
        self._away = False
        self._starts = 0
        self._started_cycle = 0
        self._next_attempt_cycle: int | None = None
        self._return: Future[None] | None = None
        self._planned = False

    def age_cycles(self, cycle: int) -> int:
        """How many cycles old the twin's last answer is."""
        return self._nodes.twin_age(cycle - self._started_cycle)

    def loop_closed(self, sample: CycleSample) -> bool:
        """Whether the tension loop is closed on the twin's data in `sample`."""
        # A sample from before the twin was taken back may still say that it is synchronized.
        fresh = not self._away and sample.cycle > self._started_cycle
        closed = fresh and self._trust.update(sample)
        if self._was_closed and not closed:
            self._note(f"tension loop open, axis 1 follows the ratio of speeds: {self._trust.doubt}")
        elif closed and self._was_closed is False:
            self._note("tension loop closed again: the twin is synchronized")
        if closed or self._was_closed is not None:
            self._was_closed = closed
        return closed

    @property
    def away(self) -> bool:
        """Whether the twin is not counted on: it is gone, or not taken back yet."""
        return self._away

    def distrust(self, reason: str) -> None:
        """Open the loop until the twin is synchronized again."""
        self._trust.forget(reason)

    def reset(self) -> None:
        """Begin to reset the twin on purpose; `returning` until it is there again."""
        self._lose("the twin is reset")
        self._planned = True
        self._begin_return()

    @property
    def returning(self) -> bool:
        """Whether a reset on purpose is under way."""
        return self._planned

    def before_cycle(self) -> None:
        """Look after the connection. Raises BenchFaultError when a reset on purpose fails."""
        nodes = self._nodes
        if self._exchange.timing.cycles % _LOOK_CYCLES == 0:
            self._look_after_process()
        if self._return is not None:
            if self._return.done():
                self._end_return(self._return)
        elif self._away:
            if nodes.twin_heard or self._is_due():
                self._begin_return()
        elif nodes.twin_name in self._exchange.silent:
            self._lose("the twin does not answer SYNC")
        elif nodes.twin_problem:
            self._lose(nodes.twin_problem)

    def _is_due(self) -> bool:
        """Whether to try again with a twin that was heard: one that was not configured sends no heartbeat."""
        return self._next_attempt_cycle is not None and self._exchange.timing.cycles >= self._next_attempt_cycle

    def _look_after_process(self) -> None:
        process = self._process
        if process is None or not process.ended or self._starts == _MOST_STARTS:
            return
        if not self._away:
            self._lose("the twin's process has ended")
        self._starts += 1
        self._note(f"the twin's process has ended and is started again ({self._starts} of {_MOST_STARTS})")
        process.restart()

    def _lose(self, reason: str) -> None:
        self._away = True
        self._trust.forget(reason)
        self._nodes.twin_is_away()
        self._journal(Change(self._exchange.timing.cycles, "twin_lost"))
        self._exchange.expect([pdo for pdo in self._nodes.expected_pdos() if pdo.vital])

    def _begin_return(self) -> None:
        """By SDO: in real time beside the cycles, in lockstep the bus stands still meanwhile."""
        self._nodes.twin_heard = False
        self._next_attempt_cycle = None
        pool = ThreadPoolExecutor(1, thread_name_prefix="twin-return")
        self._return = pool.submit(self._nodes.restart_twin)
        pool.shutdown(wait=False)
        if self._lockstep:
            self._exchange.stand_still(self._return)
            self._end_return(self._return)

    def _end_return(self, done: Future[None]) -> None:
        self._return = None
        planned, self._planned = self._planned, False
        try:
            done.result()
        except BenchFaultError as error:
            if planned:
                raise
            self._note(f"the twin was heard, but did not come back: {error}")
            self._next_attempt_cycle = self._exchange.timing.cycles + _RETRY_CYCLES
            return
        exchange = self._exchange
        if self._lockstep:
            exchange.discard_waiting()
        self._away = False
        self._started_cycle = exchange.timing.cycles
        exchange.silent.discard(self._nodes.twin_name)
        exchange.expect(self._nodes.expected_pdos(self._started_cycle))
        self._nodes.twin_is_back()
        self._journal(Change(self._started_cycle, "twin_back"))
