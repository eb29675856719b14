"""Watches of every cycle of an experiment, for any machine."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hilbench.bench.state import Reports, TwinState
from hilbench.bench.tasks.limits import LimitMonitor
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs
from hilbench.can.confinement import ControllerState
from hilbench.exchange.exchange import Exchange, Inputs
from hilbench.exchange.timeliness import Timeliness
from hilbench.processes import ChildProcess
from hilbench.topology.sample import CycleSample

#: Cycles between two checks that the supervisor is alive.
_LOOK_CYCLES = 64


class Watch(CyclicTask):
    """Notes of one source: `look`: what begins or ends in a sample, each with its kind; it may raise a fault."""

    def __init__(self, source: str, look: Callable[[CycleSample], Iterable[tuple[str, str]]], reports: Reports) -> None:
        self._source = source
        self._look = look
        self._reports = reports

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Note what is new."""
        self._note(self._look(sample))

    def _note(self, found: Iterable[tuple[str, str]]) -> None:
        for kind, text in found:
            self._reports.note(self._source, text, kind=kind)


class QuietWatch(Watch):
    """Watch of quantities that are below their limits in nearly every cycle, with a compiled check."""

    def __init__(self, source: str, watching: LimitMonitor, reports: Reports) -> None:
        super().__init__(source, watching.update, reports)
        self._watching = watching

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage that checks the sample, and reports events."""
        look = self._watching.look(sample)

        def fallback(_: int) -> bool:
            self._note(self._watching.found(sample))
            return True

        look.fallback = fallback
        return CompiledStages(after=[look])


class SupervisorWatch(CyclicTask):
    """Checks every `_LOOK_CYCLES` cycles that the supervisor's process is alive. Raises BenchFaultError if not."""

    def __init__(self, supervisor: ChildProcess, exchange: Exchange) -> None:
        self._supervisor = supervisor
        self._exchange = exchange

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Check, when it is time to."""
        if self._exchange.timing.cycles % _LOOK_CYCLES == 0:
            self._supervisor.check()

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages: nothing is to be done until the next check."""
        return CompiledStages(cycles=lambda: -self._exchange.timing.cycles % _LOOK_CYCLES)


class LatenessWatch(CyclicTask):
    """Counts late answers by sender, and reports them as a possible cause of other trouble."""

    def __init__(self, timeliness: Timeliness, twin: TwinState, reports: Reports) -> None:
        self._timeliness = timeliness
        self._twin = twin
        self._reports = reports

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Count this cycle."""
        twin_age = 0 if self._twin.away else sample.twin_age_cycles
        self._timeliness.update((*inputs.ages_cycles, twin_age))
        trouble = self._timeliness.trouble()
        if trouble:
            self._reports.condition("late samples", trouble)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages: count cycles without late answers."""

        def cycles() -> int:
            on_time = self._twin.away or sample.twin_age_cycles == 0
            return MANY if on_time and not self._timeliness.trouble() else 0

        return CompiledStages(cycles=cycles, went=self._timeliness.pass_on_time)


class ControllerWatch(CyclicTask):
    """The bench's own CAN controller. Many broken-off frames: still a bus, but not for long."""

    def __init__(self, exchange: Exchange, reports: Reports) -> None:
        self._exchange = exchange
        self._reports = reports
        self._state = ControllerState.ERROR_ACTIVE

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Note another state of the controller."""
        state = self._exchange.controller
        if state is not self._state:
            self._state = state
            self._reports.note("bus", f"the bench's CAN controller is {state.value}")

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages: no frame can be disturbed in such cycles."""
        return CompiledStages(cycles=lambda: MANY if self._exchange.controller is self._state else 0)


class EmergencyWatch(CyclicTask):
    """EMCY messages of the nodes, as notices."""

    def __init__(self, reports: Reports) -> None:
        self._reports = reports

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Note those of this cycle."""
        for emergency, count in inputs.emergencies.items():
            source = f"{emergency.node} (node {emergency.node_id})"
            self._reports.note(source, str(emergency), kind=emergency.kind, count=count)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages: no foreign frame comes in such cycles."""
        return CompiledStages()
