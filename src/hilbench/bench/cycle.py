"""The cycle of a running bench: the tasks of its machine around the exchange with the nodes, and the run's watches; one
by one, or many in one compiled call, each sample with its numbers.

It is independent of the kind of machine: set points and measurements pass through by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CompiledObserver, CycleObserver, CyclicTask, Outputs, overrides
from hilbench.compiled import COUNT, TABLE, Reals, Wholes, Wholes2, arrays_in, entry_point, load, record_type
from hilbench.cycle_program import CONTINUE, CompiledStage, CycleProgram, StageAbortedError, never
from hilbench.errors import EXIT_INTERRUPTED, BenchFaultError, HilbenchError
from hilbench.exchange.exchange import Exchange, ExchangeStages, Inputs
from hilbench.exchange.measured import COUNTED, twin_age_cycles
from hilbench.exchange.unexpected_senders import Unexpected
from hilbench.topology.sample import CycleSample

#: The cycles from which experiment and twin count.
_BEGAN = record_type("experiment", "twin", of=np.int64)
_AT = record_type("cycle", "t_s", "twin_age_cycles", "bus_bits", of=np.int64)


class _Arrays(NamedTuple):
    """What is counted, from where, the length of a cycle in s (1,), and the sample with the places of its numbers."""

    counted: Annotated[Any, COUNTED]
    began: Annotated[Any, _BEGAN]
    cycle_s: Reals
    values: Reals
    words: Wholes
    at: Annotated[Any, _AT]


@entry_point(COUNT, TABLE)
def _stamp(_: int, table: Wholes2) -> int:
    a = arrays_in(table, _Arrays)
    cycle = a.counted.cycles
    a.words[a.at.cycle] = cycle
    a.values[a.at.t_s] = (cycle - a.began.experiment) * a.cycle_s[0]
    a.words[a.at.twin_age_cycles] = twin_age_cycles(cycle - a.began.twin, a.counted.twin_sync)
    a.words[a.at.bus_bits] = a.counted.bits
    return CONTINUE


class Stamp:
    """Stamps the samples of one bench, after each exchange."""

    def __init__(self, state: BenchState, exchange: Exchange) -> None:
        load(_stamp)
        self._state, sample = state, state.sample
        self._began = np.zeros(1, _BEGAN)
        arrays = _Arrays(
            *(exchange.counted, self._began, np.array([state.cycle_s]), sample.reals, sample.wholes),
            type(sample).places(list(_AT.names or ())),
        )
        #: Compiled stage that stamps, by the last `begin`.
        self.piece = CompiledStage(_stamp, 0, arrays, fallback=never)

    def __call__(self) -> None:
        """Stamp this cycle's sample."""
        self.begin()
        self.piece()

    def begin(self) -> None:
        """Experiment and twin count from where they do now."""
        self._began[0] = self._state.first_cycle, self._state.twin.started_cycle


#: Fewer cycles are not worth it.
_LEAST = 2


class CompiledCycles:
    """The cycles of a bench as a program, whose stages are those of its tasks, in the order in which they run.

    `finish`: run the rest of a cycle in which nothing but set points is there yet.
    """

    def __init__(
        self,
        state: BenchState,
        exchange: Exchange,
        stamp: Stamp,
        watches: Sequence[CyclicTask],
        machine: Sequence[CyclicTask],
        observers: Sequence[CycleObserver],
        finish: Callable[[Outputs], None],
    ) -> None:
        self._state, self._exchange, self._stamp, self._finish = state, exchange, stamp, finish
        self._chain: CycleProgram | None = None
        self._of: Sequence[CompiledStage] = ()
        sample = state.sample
        found = [each.compiled_stages(sample) for each in (*watches, *machine)]
        found += [each.compiled_stages(sample) if isinstance(each, CompiledObserver) else None for each in observers]
        #: Whether every part of a cycle can be done so.
        self._possible = None not in found and not exchange.runs_by_clock
        parts = [each for each in found if each is not None]
        count, all_of = len(watches), len(watches) + len(machine)
        self._watches, self._machine, self._observers = parts[:count], parts[count:all_of], parts[all_of:]
        self._parts = parts
        self._shown = {output: signal for each in self._machine for output, signal in each.shown.items()}

    def run(self, cycles: int) -> int:
        """Run up to `cycles` compiled. Returns the number run; 0: the next needs Python. Raises as `BenchCycle.run`."""
        if not self._possible:
            return 0
        with self._exchange.chained(self._state.sample, self._shown) as stages:
            if stages is None:
                return 0
            for each in self._parts:
                cycles = min(cycles, each.cycles())
                if cycles < _LEAST:
                    return 0
            cycles = min(cycles, stages.cycles())
            if cycles < _LEAST:
                return 0
            done, left = self._run(stages, cycles)
        if left:
            sample = self._state.sample
            self._finish({output: getattr(sample, signal) for output, signal in self._shown.items()})
        return done + left

    def _run(self, stages: ExchangeStages, cycles: int) -> tuple[int, bool]:
        """Number of cycles completed, and True if a further one has its set points already."""
        chain, left = self._chain_of(stages), False
        stopped: int | None = None
        try:
            chain.run(cycles)
        except StageAbortedError:
            left = True
        except BaseException:
            stopped = chain.stopped_at
            raise
        finally:
            self._pass(stages, chain.done, stopped)
        return chain.done, left

    def _pass(self, stages: ExchangeStages, done: int, stopped: int | None) -> None:
        """Report the cycles run to their counters; of an aborted one only to those whose stage was reached."""
        stages.passed()
        for each, turn in zip(self._parts, self._turns, strict=True):
            each.went(done + (stopped is not None and turn <= stopped))

    def _chain_of(self, stages: ExchangeStages) -> CycleProgram:
        self._stamp.begin()
        if self._chain is None or self._of is not stages.pieces:
            self._of = stages.pieces
            self._chain = CycleProgram(self._put_together(stages.pieces))
        return self._chain

    def _put_together(self, exchange: Sequence[CompiledStage]) -> list[CompiledStage]:
        pieces: list[CompiledStage] = []
        for each in (*self._watches, *self._machine):
            pieces += each.before
        pieces += [*exchange, self._stamp.piece]
        turns: dict[int, int] = {}
        for each in (*self._machine, *self._watches, *self._observers):
            turns[id(each)] = len(pieces)
            pieces += each.after
        self._turns = [turns[id(each)] for each in self._parts]
        return pieces


class InterruptedByOperatorError(HilbenchError):
    """The operator asked the run to end; the drives were stopped."""

    exit_code = EXIT_INTERRUPTED


class BenchCycle:
    """The cycle of one bench whose nodes are operational.

    `machine`: the tasks of the machine, in each exchange; `watches`: those of the run, in each cycle of the experiment;
    `stop_on_unexpected_frames`: frames that only a foreign sender can have sent are a fault.
    """

    def __init__(
        self,
        state: BenchState,
        exchange: Exchange,
        *,
        machine: Sequence[CyclicTask],
        watches: Sequence[CyclicTask],
        observers: Sequence[CycleObserver],
        stop_on_unexpected_frames: bool,
    ) -> None:
        self._state = state
        self._exchange = exchange
        self._stamp = Stamp(state, exchange)
        # Now, and not when the first cycle is due: making the stages takes longer than a short one.
        self._chained = CompiledCycles(state, exchange, self._stamp, watches, machine, observers, self._finish)
        self._command = [task.before for task in machine if overrides(task, "before")]
        self._rest = [task.rest for task in machine if overrides(task, "rest")]
        self._follow = [task.after for task in machine if overrides(task, "after")]
        self._watch_before = [task.before for task in watches if overrides(task, "before")]
        self._watch_after = [task.after for task in watches if overrides(task, "after")]
        self._observers = observers
        self._stop_on_unexpected_frames = stop_on_unexpected_frames
        self._in_cycle = False

    def run(self) -> CycleSample:
        """Run a cycle of the experiment. Raises BenchFaultError on faults and limits, InterruptedByOperatorError."""
        self._in_cycle = True
        try:
            return self._run()
        finally:
            self._in_cycle = False

    def run_many(self, cycles: int) -> None:
        """Run so many cycles, compiled where possible. Raises as `run`."""
        while cycles > 0:
            done = self.run_compiled(cycles)
            if not done:
                self.run()
                done = 1
            cycles -= done

    def run_compiled(self, cycles: int) -> int:
        """Run up to `cycles` compiled. Returns the number run; 0 if the next one needs Python. Raises as `run`."""
        if not self._state.enabled or self._state.interrupt_requested:
            return 0
        self._in_cycle = True
        try:
            return self._chained.run(cycles)
        finally:
            self._in_cycle = False

    def stay_alive(self, silence_s: float) -> None:
        """Send a heartbeat from another thread between two cycles; a cycle that hangs is left to the supervisor."""
        if not self._in_cycle:
            self._exchange.stay_alive(silence_s)

    def _run(self) -> CycleSample:
        sample, outputs = self._state.sample, Outputs()
        if self._state.interrupt_requested:
            raise InterruptedByOperatorError("interrupted, drives were stopped")
        for before in self._watch_before:
            before(sample, outputs)
        return self._see(self.exchange())

    def _finish(self, outputs: Outputs) -> None:
        """Run the rest of a cycle whose set points are computed."""
        self._see(self._exchange_with(outputs))

    def _see(self, inputs: Inputs) -> CycleSample:
        sample = self._state.sample
        for after in self._watch_after:
            after(sample, inputs)
        for observer in self._observers:
            observer.sample(sample)
        return sample

    def exchange(self, instead: Mapping[str, float] | None = None) -> Inputs:
        """Set points and SYNC out, measurements in; the machine's tasks rest while the drives are disabled.

        `instead`: outputs that replace those of the tasks.
        """
        state = self._state
        sample, outputs = state.sample, Outputs()
        for command in self._command if state.enabled else self._rest:
            command(sample, outputs)
        outputs.update(instead or {})
        return self._exchange_with(outputs)

    def _exchange_with(self, outputs: Outputs) -> Inputs:
        state, exchange, sample = self._state, self._exchange, self._state.sample
        try:
            inputs = exchange.cycle(outputs)
        finally:
            if exchange.unexpected_frames:
                self._report(exchange.unexpected_frames)
        if exchange.unexpected_frames:
            self._check(exchange.unexpected_frames)
        inputs.fill(sample)
        self._stamp()
        if state.enabled:
            for follow in self._follow:
                follow(sample, inputs)
        return inputs

    def _report(self, unexpected_frames: Sequence[Unexpected]) -> None:
        """Report foreign frames: another sender that sends as the bench or its nodes do, or changes them."""
        reports = self._state.reports
        for found in unexpected_frames:
            source = f"foreign frames, {found.about}"
            reports.note(source, found.text, count=found.count)
            if found.certain:
                reports.condition("foreign frames", f"{source}: {found.text}")

    def _check(self, unexpected_frames: Sequence[Unexpected]) -> None:
        if not self._stop_on_unexpected_frames or self._state.stopping:
            return
        for found in unexpected_frames:
            if found.certain:
                time_s = self._state.sample.t_s
                raise BenchFaultError(f"t = {time_s:.3f} s: foreign frames, {found.about}: {found.text}")
