"""One cycle of a running bench: the tasks of its machine around the exchange with the nodes, and the run's watches.

It is independent of the kind of machine: set points and measurements pass through by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hilbench.bench.compiled_cycles import CompiledCycles, Stamp
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CycleObserver, CyclicTask, Outputs, overrides
from hilbench.errors import EXIT_INTERRUPTED, BenchFaultError, HilbenchError
from hilbench.exchange.exchange import Exchange, Inputs
from hilbench.exchange.unexpected_senders import Unexpected
from hilbench.topology.sample import CycleSample


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
