"""A running bench: the object that an experiment steers cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.cycle import BenchCycle, InterruptedByOperatorError
from hilbench.bench.lifecycle import idle
from hilbench.bench.lifecycle.drives import Drives
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.lifecycle.startup import TWIN, StartedBench, bring_up, held_bus
from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.model_changes.process import LiveProcess
from hilbench.bench.model_changes.task import ModelChanges
from hilbench.bench.operator.operator import Operator, StepEvent
from hilbench.bench.prediction.create import prediction_task
from hilbench.bench.prediction.task import Prediction
from hilbench.bench.reports.change import Change
from hilbench.bench.reports.notice import Notices
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CycleObserver
from hilbench.bench.tasks.twin_connection import TwinConnection
from hilbench.bench.tasks.watches import ControllerWatch, EmergencyWatch, LatenessWatch, SupervisorWatch
from hilbench.crash_report import TRACEBACK_FILE, crash_report
from hilbench.did_you_mean import expected_one_of
from hilbench.errors import BenchFaultError, NoAnswerError, UnusableValueError
from hilbench.exchange import measured
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.frame_tap import FrameTap
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.timeliness import Timeliness
from hilbench.forked_workers import ForkedWorker
from hilbench.machine_kinds import machine_part
from hilbench.prediction.plan import Asked, Move, Plan
from hilbench.processes import ChildProcess, finishing
from hilbench.topology import quantities
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample, sample_type
from hilbench.twin.estimated_errors import EstimatedModelError, read_text

__all__ = ["Bench", "CycleObserver", "InterruptedByOperatorError", "StepEvent"]

#: What a signal waits for while a bench is left.
_STOP = "the drives are brought to a stop"


class Bench:
    """Drives, the machine's tasks and the twin of one config, running on its bus.

    Use it as a context manager::

        with Bench(config) as bench:
            bench.ramp("line_speed_m_s", 3.0, duration_s=4.0)
            bench.step("load.web.youngs_modulus_Pa", 10.5e9)
            bench.run(40.0)

    Entering starts the processes, configures the nodes and enables the drives; it raises BenchFaultError when
    something does not answer or does not come up. Time passes only in `cycle`, `run`, `ramp` and `wait_until`;
    what `set` changes acts from the next cycle on. Leaving brings the drives to a stop (by quick stop when it is
    left through an exception), ends the processes and leaves the bus.

    `tap` receives every frame on the bus; `work_folder` keeps the processes' config and logs (a temporary folder if not
    given); `participants`: where simulated hardware and twin run, started by this bench unless given otherwise;
    `announce` gets progress messages, and the notices unless `warn` does; `journal` gets changes by the bench that no
    frame shows; `may_idle`: in lockstep with simulated nodes any time may pass between two cycles
    (`hilbench.bench.lifecycle.idle`).
    A bench is the only master of its bus: a bus with another is refused (UnusableInputError), with `force` only where
    a program of this machine claims to be the master. `bus_is_held`: the caller is inside
    `startup.held_bus` already. `forked_workers`: copies of this process, by the names of the processes they become
    (`startup.copies_beside`).

    `notices` collects events of a running run for the operator, counted by source and kind: limit warnings,
    EMCY messages, a tension loop that opens or closes. Losing the twin ends no run: the loop holds, and the
    twin is taken back (after a restart of its process, if the bench had started it) as soon as it answers again.
    """

    def __init__(
        self,
        config: BenchConfig,
        *,
        observers: Sequence[CycleObserver] = (),
        tap: FrameTap | None = None,
        work_folder: Path | None = None,
        participants: Participants = Participants.STARTED,
        announce: Callable[[str], None] = lambda text: None,
        warn: Callable[[str], None] | None = None,
        journal: Callable[[Change], None] = lambda change: None,
        may_idle: bool = False,
        force: bool = False,
        bus_is_held: bool = False,
        forked_workers: dict[str, ForkedWorker] | None = None,
    ) -> None:
        self.config = config
        self.timeliness = Timeliness((), config.cycle_time_s)  #: late answers by sender, since the drives were enabled
        self.nodes: Nodes
        self.model_changes: ModelChanges | None = None  #: findings of the live diagnosis; None: it was not running
        self.children: list[ChildProcess] = []
        self._observers = list(observers)
        self._tap = tap
        self._work_folder = work_folder
        self._participants = participants
        self._force = force
        self._bus_is_held = bus_is_held
        self._copies = {} if forked_workers is None else forked_workers
        self._announce = announce
        self._may_idle = may_idle and idle.may_idle(config)
        self._resources = ExitStack()
        self._state = BenchState(config.cycle_time_s, sample_type(config.signals)(), announce, journal, warn=warn)
        self._machine: MachineTasks = machine_part(config.machine.kind, "tasks")(config, self._state)
        self._quantities = list(self._machine.quantities)
        self._operator = Operator(config, self._state, self._machine.reference, self._quantities)
        self._plan = Plan()
        #: None where the config asks for none.
        self.prediction: Prediction | None = prediction_task(config, self._state, self._asked, self._machine.reference)
        self._live: LiveProcess | None = None
        self._twin: TwinConnection
        self._cycle: BenchCycle
        #: What the twin has found of errors of its model, once the drives were disabled.
        self.found_beside: Sequence[EstimatedModelError] = ()
        self._drives: Drives | None = None  # before the nodes are operational

    # -- start and end -----------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        self._state.require_new()
        try:
            self._start_diagnosis()
            self._announce("prepare the model")
            self._machine.warm_up()
            measured.warm_up()
            if self.prediction is not None:
                self.prediction.warm_up()
                self._resources.callback(self.prediction.close)
            if self._live is not None:
                self._live.wait_until_ready()
            if not self._bus_is_held:
                self._resources.enter_context(held_bus(self.config, self._participants, force=self._force))
            started = self._resources.enter_context(
                bring_up(
                    self.config,
                    objects=self._operator.objects.store,
                    tap=self._tap,
                    work_folder=self._work_folder,
                    participants=self._participants,
                    announce=self._announce,
                    forked_workers=self._copies,
                )
            )
            drives = self._run_on(started)
            self._announce("enable drives")
            drives.enable()
            if self._may_idle:
                silence_s = self.config.master.heartbeat_ms * 1e-3
                stay_alive = partial(self._cycle.stay_alive, silence_s)
                self._resources.enter_context(idle.meanwhile(stay_alive, silence_s, "bench-idle"))
        except BaseException as error:
            with finishing(_STOP):
                try:
                    self._safe_stop(error)
                finally:
                    self._leave()
            raise
        return self

    def _run_on(self, started: StartedBench) -> Drives:
        """Put the cycle together for nodes that are operational."""
        config, state, nodes, exchange = self.config, self._state, started.nodes, started.exchange
        self.nodes, self.children = nodes, started.children
        state.exchange, state.phase = exchange, "running"
        participants = (*map(nodes.sender, nodes.drives), nodes.twin_name)
        self.timeliness = Timeliness(participants, config.cycle_time_s)
        self._quantities.append(nodes)
        self._twin = TwinConnection(
            state,
            nodes,
            exchange,
            next((child for child in started.children if child.name == TWIN), None),
            age_limit_cycles=self._machine.twin_age_limit_cycles,
        )
        self.model_changes = self._diagnosis_beside(nodes, exchange)
        if self.model_changes is not None:
            self._quantities.append(self.model_changes)
        watches = [
            self._operator,
            self._twin,
            *([SupervisorWatch(started.supervisor, exchange)] if started.supervisor else []),
            LatenessWatch(self.timeliness, state.twin, state.reports),
            ControllerWatch(exchange, state.reports),
            EmergencyWatch(state.reports),
            *([self.prediction] if self.prediction else []),
            *self._machine.watches,
            *([self.model_changes] if self.model_changes is not None else []),
        ]
        self._cycle = BenchCycle(
            state,
            exchange,
            machine=self._machine.control,
            watches=watches,
            observers=self._observers,
            stop_on_unexpected_frames=config.safety.on_foreign_frames == "stop",
        )
        self._drives = Drives(state, nodes, exchange, self._cycle, crash_report=self._unexpected)
        for warning in started.warnings:
            state.reports.note("realtime", warning)
        return self._drives

    def _start_diagnosis(self) -> None:
        """Start the process of the live diagnosis, where the config asks for one: it loads while others do."""
        config = self.config
        if config.twin.live_diagnosis is None:
            return
        folder = self._work_folder
        if folder is None:
            folder = Path(self._resources.enter_context(TemporaryDirectory(prefix="hilbench-live-")))
        self._live = LiveProcess(config, folder)
        self._resources.callback(self._live.end)

    def _diagnosis_beside(self, nodes: Nodes, exchange: Exchange) -> ModelChanges | None:
        """Task that follows the live diagnosis, where the config asks for it."""
        config, live = self.config, self.config.twin.live_diagnosis
        if live is None or self._live is None:
            return None
        simulated = all(part.is_ours for part in config.parts)
        return ModelChanges(
            self._state,
            nodes,
            exchange,
            self._live,
            config.signals,
            config.machine,
            apply=simulated if live.model_changes is None else live.model_changes == "apply",
            last=config.process_settings("twin"),
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with finishing(_STOP):
            try:
                if kind is None:
                    try:
                        self._announce("disable drives")
                        if self._drives is not None:
                            self._drives.disable(self._operator)
                            self._ask_the_twin()
                    except BaseException as failure:
                        self._safe_stop(failure)
                        raise
                else:
                    try:
                        self._announce("quick stop")
                    finally:  # a broken display must not keep the drives from being stopped
                        self._safe_stop(error)
            finally:
                self._leave()

    def _ask_the_twin(self) -> None:
        """Read the model errors that the twin has found; none from a twin that is away or does not answer."""
        if self._state.twin.away:
            return
        with suppress(BenchFaultError, ValueError):
            self.found_beside = read_text(self.nodes.twin_found())

    def _safe_stop(self, reason: BaseException | None) -> None:
        if isinstance(reason, NoAnswerError):  # last words of an ended process give the reason
            for child in self.children:
                if child.ended:
                    reason.add_cause(f"{child.name} ended by itself: {child.last_words()}")
        self._state.end(reason)
        if self._drives is not None:
            self._drives.stop(reason)
            self._report_coasting_axes(self._drives, reason)

    def _report_coasting_axes(self, drives: Drives, reason: BaseException | None) -> None:
        """A fault has it as its consequence."""
        if isinstance(reason, BenchFaultError):
            for name, what in drives.coasting.items():
                held = self._machine.holds.get(name, "")
                reason.add_consequence(f"{what}{f': nothing holds {held}' if held else ''}")

    def _leave(self) -> None:
        self._state.phase = "ended"
        self._resources.close()

    def _unexpected(self, error: Exception) -> str:
        return crash_report(error, self._work_folder / TRACEBACK_FILE if self._work_folder else None)

    # -- state and notices -------------------------------------------------------------------------------

    @property
    def last(self) -> CycleSample:
        """The last cycle; the object is reused, so copy what is kept."""
        return self._state.sample

    @property
    def events(self) -> list[StepEvent]:
        """The steps under test until now."""
        return self._operator.events

    @property
    def twin_refusals(self) -> int | None:
        """Number of times that torques and encoders have opened a tension loop, see `TwinState`."""
        return self._state.twin.refusals

    def note(self, source: str, text: str) -> None:
        """Something that an operator must know, from whoever uses the bench; it is one of the `notices`."""
        self._state.reports.note(source, text)

    @property
    def notices(self) -> Notices:
        """Notices to the operator of the run."""
        return self._state.reports.notices

    @property
    def exchange(self) -> Exchange | None:
        """The cyclic path, once the nodes are operational."""
        return self._state.exchange

    @property
    def enabled(self) -> bool:
        """True if the drives are enabled, and the experiment's time advances."""
        return self._state.enabled

    @property
    def stopping(self) -> bool:
        """True if the drives are being brought to a stop."""
        return self._state.stopping

    @property
    def fault_time_s(self) -> float | None:
        """Time at which the cause of the safe state was detected."""
        return self._state.fault_time_s

    @property
    def safe_state_problems(self) -> list[str]:
        """Problems that kept the bench from confirming the safe state."""
        return self._state.safe_state_problems

    def request_interrupt(self) -> None:
        """End the run between two cycles: the next one raises InterruptedByOperatorError."""
        self._state.interrupt_requested = True

    def foresee(self, plan: Plan) -> None:
        """Set the planned moves of the experiment; predictions use them."""
        self._plan = plan

    def refuse_if_predicted(self, path: str, to: float, duration_s: float, above: float) -> None:
        """Predict a move of a quantity to `to` from now on; cycles run until the prediction is there.

        Raises PredictedLimitError when a trip level would be crossed with a probability above `above`, BenchFaultError
        when there is no prediction (the twin is not synchronized), UnusableValueError where the config asks for no
        prediction.
        """
        prediction = self.prediction
        if prediction is None:
            raise UnusableValueError("twin.prediction is not given, expected it for a step that is checked by it")
        prediction.refuse_if_predicted(path, to, duration_s, above, self.cycle)

    def _asked(self) -> Asked:
        """Present values, planned moves and ceilings of the quantities, for predictions."""
        config, reference, now_s = self.config, self._machine.reference, self.time_s
        plan, goal = self._plan, reference.goal
        if goal is not None:
            lasts_s = abs(goal - reference.present) / config.quick_stop_per_s2
            plan = plan.with_moves([Move(reference.path, now_s, now_s + lasts_s, goal)])
        ceilings = {} if reference.ceiling is None else {reference.path: reference.ceiling}
        return Asked({path: self._operator.get(path) for path in config.fast_path_places}, plan, ceilings)

    # -- time --------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Experiment time: of the last sample, counted from the first cycle with all drives enabled."""
        return self.last.t_s

    def experiment_time_s(self, cycle: int) -> float:
        """Experiment time of a cycle, counted as in `CycleSample`; negative before the drives were enabled."""
        return self._state.experiment_time_s(cycle)

    def cycle(self) -> CycleSample:
        """Run one cycle: set points and SYNC out, measurements in.

        Raises BenchFaultError on faults and limits; BenchNotRunningError before the bench was entered and once it was
        left, as everything that reads or changes something of it.
        """
        self._state.running()
        return self._cycle.run()

    def run(self, duration_s: float) -> None:
        """Run for a time, rounded to whole cycles. Raises UnusableValueError for what is no time of 0 or more."""
        duration_s = quantities.checked_duration_s("duration_s", duration_s)
        self._state.running()
        self._cycle.run_many(round(duration_s / self.config.cycle_time_s))

    def ramp(self, path: str, to: float, duration_s: float) -> None:
        """Move a quantity linearly to `to` within `duration_s`, which is above 0.

        Raises as `set`, before anything moves; for a switch, and for a duration that is none, too.
        """
        self._operator.ramp(path, to, duration_s, self)

    def follow_values(self, path: str, values: NDArray[np.float64]) -> None:
        """Give a quantity these values (n,), one in each of the next n cycles. Raises as `set`, before any of them."""
        path = quantities.checked_path(path)
        for value in {float(values.min()), float(values.max())}:
            quantities.checked_value(path, value)
        self._state.running()
        self._operator.follow(path, values, self)

    def cycles_at_once(self, most: int) -> int:
        """Run up to `cycles` compiled, from the next one on. Returns the number run; 0 if the next one needs Python.
        Raises as `cycle`."""
        self._state.running()
        return self._cycle.run_compiled(most)

    def wait_until(self, condition: Callable[[CycleSample], bool], *, timeout_s: float, for_s: float = 0.0) -> bool:
        """Run until `condition` has held for `for_s` without a break; False when it did not within `timeout_s`.

        Raises UnusableValueError for a condition that can't be called, times that are none, and a `for_s` that is
        longer than `timeout_s`.
        """
        if not callable(condition):
            raise UnusableValueError(f"condition is {condition!r}, expected a function of a sample that says yes or no")
        timeout_s = quantities.checked_duration_s("timeout_s", timeout_s, above_zero=True)
        for_s = quantities.checked_duration_s("for_s", for_s)
        if for_s > timeout_s:
            raise UnusableValueError(f"for_s is {for_s:g}, expected at most timeout_s, which is {timeout_s:g}")
        self._state.running()
        cycle_s = self.config.cycle_time_s
        needed = max(1, round(for_s / cycle_s))
        held = 0
        for _ in range(round(timeout_s / cycle_s)):
            held = held + 1 if condition(self.cycle()) else 0
            if held >= needed:
                return True
        return False

    def follow(self, experiment: Generator[None, CycleSample, None]) -> None:
        """Run cycles for a generator that is resumed after each of them, until it returns.

        ``sample = yield`` is one cycle; what the generator sets then acts in the next one::

            def experiment(bench):
                bench.set("line_speed_m_s", 1.0)
                while (yield).v2_m_s < 0.9:
                    pass
        """
        self._state.running()
        try:
            next(experiment)
            while True:
                experiment.send(self.cycle())
        except StopIteration:
            return
        finally:
            experiment.close()

    # -- what can be changed -----------------------------------------------------------------------------

    def get(self, path: str) -> float:
        """Present value of a quantity (see `hilbench.topology.quantities`).

        Raises UnusableValueError for an unknown path.
        """
        return self._operator.get(path)

    def set(self, path: str, value: float) -> None:
        """Give a quantity a value from the next cycle on.

        Raises UnusableValueError (a ValueError too) for an unknown path or a value it can't have.
        """
        self._operator.set(path, value)

    def step(self, path: str, to: float) -> None:
        """`set`, noted as the event under test that metrics and report refer to. Raises as `set`."""
        self._operator.step(path, to)

    def restart_twin(self) -> None:
        """Reset the twin during the run: it finds motion, tension and E anew; the tension loop stays open until then.

        In real time the bench goes on meanwhile; in lockstep no cycle runs.
        """
        self._state.running()
        self._twin.reset()
        while self._twin.returning:
            self.cycle()

    def use_synchronizer(self, method: str) -> None:
        """Switch the twin to another synchronization method, from its present E.

        Raises UnusableValueError for an unknown one, and for a machine whose twin has one method.
        """
        kind = self.config.machine.kind
        methods = list(machine_part(kind, "topology").METHODS)
        if not methods:
            raise UnusableValueError(f"method {method!r}, expected none: the twin of a {kind} has one method")
        if method not in methods:
            raise UnusableValueError(f"method {method!r}{expected_one_of(str(method), methods)}")
        self._state.running()
        self.nodes.use_synchronizer(methods.index(method) + 1)
