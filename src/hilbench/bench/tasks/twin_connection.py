"""The bench's connection to its twin: lost when it does not answer, taken back when it answers again.

The bench can do without its twin: the controllers decide what to do meanwhile (`TwinState.fresh`). A twin
that comes back, whether it was held up or its process had to be started again, is reset and configured anew, because
it is unknown what it has missed; the loop closes when it reports that it is synchronized.

That takes SDO transfers, which nothing waits for: cycles continue meanwhile. Only in lockstep no cycle runs for
the short time in which a twin answers, so that a reset on purpose is in the same cycles on every machine.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.nodes import Nodes
from hilbench.processes import ChildProcess
from hilbench.topology.sample import CycleSample

#: So often the twin's process is started again in one run.
_MOST_STARTS = 3
#: Cycles from a loss of the twin, or an attempt to take it back, to the next attempt where nothing is received from it.
_RETRY_CYCLES = 500
#: A twin that was back for so many cycles is not lost again and again. After so many losses in a row that time doubles
#: with each further one, so many times.
_STAYED_CYCLES, _LOSSES_FREE, _MOST_DOUBLINGS = 5000, 3, 6
#: Cycles between two checks that the process is alive.
_LOOK_CYCLES = 64
#: Lockstep: longest time without a cycle while the twin is reset, far less than the nodes' SYNC time-out.
_STAND_STILL_S = 1.0
#: Cycles within which a twin that was started while SYNCs were running reports which of them it has counted, and for
#: which an answer may report another count.
_REPORT_CYCLES = 100


class TwinConnection(CyclicTask):
    """Supervises the connection in one run, and keeps `state.twin`. `process` is None when another program started the
    twin; `age_limit_cycles`: age of its data from which they may be those of a twin that counts SYNC anew."""

    def __init__(
        self,
        state: BenchState,
        nodes: Nodes,
        exchange: Exchange,
        process: ChildProcess | None,
        *,
        age_limit_cycles: int,
    ) -> None:
        self._twin = state.twin
        self._nodes = nodes
        self._exchange = exchange
        self._process = process
        self._reports = state.reports
        self._journal = state.journal
        self._starts = 0
        self._age_limit = age_limit_cycles
        self._age_before = self._jumped_for = 0
        self._lost_cycle = self._losses = 0
        self._return: Future[None] | None = None
        self._returned_cycle: int | None = None  # when it was started with SYNCs running, and reports no count
        self.returning = False  #: true if a reset on purpose is under way

    def reset(self) -> None:
        """Begin to reset the twin on purpose; `returning` until it is there again."""
        self._lose("the twin is reset")
        self.returning, self._losses = True, 0
        self._begin_return()

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Look after the connection. Raises BenchFaultError when a reset on purpose fails."""
        nodes = self._nodes
        if self._exchange.timing.cycles % _LOOK_CYCLES == 0:
            self._look_after_process()
        if self._return is not None:
            if self._return.done():
                self._end_return(self._return)
        elif self._returned_cycle is not None:
            self._look_for_count(self._returned_cycle)
        elif self._twin.away:
            if self._is_due():
                self._begin_return()
        elif self._exchange.silent and nodes.twin_name in self._exchange.silent:
            self._lose("the twin does not answer SYNC")
        elif nodes.twin_problem:
            self._lose(nodes.twin_problem)
        elif self._counts_anew():
            self._lose("the twin counts SYNC anew, as after a foreign NMT command")

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages: nothing is to be done while the twin answers."""
        return CompiledStages(cycles=self._is_regular)

    def _is_regular(self) -> int:
        """Number of cycles without work, if answers come as they did."""
        nodes, cycles = self._nodes, self._exchange.timing.cycles
        busy = self._return is not None or self._returned_cycle is not None or self._twin.away or self._jumped_for
        if busy or nodes.twin_problem or (self._exchange.silent and nodes.twin_name in self._exchange.silent):
            return 0
        age = nodes.twin_age(cycles - self._twin.started_cycle)
        if age != self._age_before or age > self._age_limit:
            return 0
        return -cycles % _LOOK_CYCLES if self._process is not None else MANY

    def _counts_anew(self) -> bool:
        """True if the age of the twin's answers has jumped, which late answers can't cause, and stays so."""
        age = self._nodes.twin_age(self._exchange.timing.cycles - self._twin.started_cycle)
        if age <= self._age_limit:
            self._jumped_for = 0
        elif self._jumped_for or age > self._age_before + 1:
            self._jumped_for += 1
        self._age_before = age
        return self._jumped_for > _REPORT_CYCLES

    def _is_due(self) -> bool:
        """True if the twin is to be reset: at once when it has sent something, else later (one that was not configured
        sends no heartbeat), and ever more rarely while it is lost again and again."""
        waited = self._exchange.timing.cycles - self._lost_cycle
        again = max(0, self._losses - _LOSSES_FREE)
        if self._nodes.twin_alive and not again:
            return True
        return waited >= _RETRY_CYCLES << min(again, _MOST_DOUBLINGS)

    def _look_after_process(self) -> None:
        process = self._process
        if process is None or not process.ended or self._starts == _MOST_STARTS:
            return
        if not self._twin.away:
            self._lose("the twin's process has ended")
        self._starts += 1
        self._reports.note(
            "twin", f"the twin's process has ended and is started again ({self._starts} of {_MOST_STARTS})"
        )
        process.restart()

    def _lose(self, reason: str) -> None:
        self._twin.away = True
        self._age_before = self._jumped_for = 0
        cycle = self._exchange.timing.cycles
        self._losses = self._losses + 1 if cycle - self._twin.back_cycle < _STAYED_CYCLES else 1
        self._lost_cycle = cycle
        self._twin.why = reason
        self._nodes.twin_is_away()
        self._journal(Change(self._exchange.timing.cycles, "twin_lost"))
        self._exchange.expect_drives()

    def _begin_return(self) -> None:
        answers = self.returning or self._nodes.twin_alive
        self._nodes.twin_alive = False
        pool = ThreadPoolExecutor(1, thread_name_prefix="twin-return")
        self._return = pool.submit(self._nodes.restart_twin)
        pool.shutdown(wait=False)
        if self._exchange.in_step and answers:
            self._exchange.stand_still(self._return, _STAND_STILL_S)
            if self._return.done() and self._end_return(self._return):
                self._exchange.discard_waiting()
                self._take_back(self._exchange.timing.cycles)

    def _end_return(self, done: Future[None]) -> bool:
        """True if the twin was started; it is taken back when it has reported which SYNCs it counts."""
        self._return = None
        try:
            done.result()
        except BenchFaultError as error:
            self._fail(error)
            return False
        self._returned_cycle = self._exchange.timing.cycles
        return True

    def _fail(self, error: BenchFaultError) -> None:
        self._returned_cycle = None
        if self.returning:
            self.returning = False
            raise error
        self._reports.note("twin", f"the twin did not come back: {error}")
        self._losses += 1
        self._lost_cycle = self._exchange.timing.cycles

    def _look_for_count(self, returned_cycle: int) -> None:
        """Take the twin back once it reports its count; one reported earlier may be from before its reset."""
        cycle, nodes = self._exchange.timing.cycles, self._nodes
        if nodes.twin_reported_cycle > returned_cycle:
            self._take_back(nodes.twin_started(nodes.twin_reported_cycle))
        elif cycle - returned_cycle > _REPORT_CYCLES:
            self._fail(BenchFaultError(f"it was started, and reports nothing within {_REPORT_CYCLES} cycles"))

    def _take_back(self, started_cycle: int) -> None:
        """`started_cycle`: the SYNC before that which the twin counts as its first."""
        exchange = self._exchange
        self._returned_cycle, self.returning = None, False
        self._twin.away = False
        self._twin.started_cycle, self._twin.back_cycle = started_cycle, exchange.timing.cycles
        exchange.expect_all(started_cycle)
        self._nodes.twin_is_back()
        self._journal(Change(self._twin.back_cycle, "twin_back", value=float(started_cycle)))
