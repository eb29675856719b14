"""A running bench: one object that an experiment steers cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from math import copysign
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol, Self

from hilbench.bench.lifecycle import idle
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.lifecycle.safety import confirm_stopped, quick_stop
from hilbench.bench.lifecycle.startup import TWIN, bring_up, held_bus
from hilbench.bench.operator.causes import Causes
from hilbench.bench.operator.change import Change
from hilbench.bench.operator.notice import Notices
from hilbench.bench.operator.operator_objects import OperatorObjects
from hilbench.bench.tasks.limits import LimitWatch
from hilbench.bench.tasks.load_model import LoadModel
from hilbench.bench.tasks.saturation import SaturationWatch
from hilbench.bench.tasks.swing_damping import SwingDamping, SwingPlant
from hilbench.bench.tasks.tension_control import TensionController
from hilbench.bench.twin_connection import TwinConnection
from hilbench.can.confinement import ControllerState
from hilbench.cia402.drive import Drive, DriveGoal
from hilbench.errors import (
    EXIT_INTERRUPTED,
    BenchFaultError,
    BenchNotRunningError,
    EmergencyStopError,
    HilbenchError,
    UnusableValueError,
)
from hilbench.estimation.plausibility import Problem
from hilbench.estimation.synchronizers.create import METHODS
from hilbench.exchange.cycle import CyclicExchange, FrameTap
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.timeliness import Timeliness
from hilbench.processes import ChildProcess
from hilbench.suggest import did_you_mean
from hilbench.topology import quantities
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample, sample_type
from hilbench.unexpected import TRACEBACK_FILE, unexpected

#: Time for the axes to stand still again after the load motor has let go.
_SETTLE_S = 0.3
#: What is said of a bench that is not running (any more).
_WHERE = {"made": "has not been entered", "running": "has been entered already", "ended": "has been left"}
#: Cycles of late data of the twin that the tension controller makes up for in one step.
_MOST_CYCLES_AT_ONCE = 10
#: Cycles between two looks whether the supervisor lives.
_LOOK_CYCLES = 64


class InterruptedByOperatorError(HilbenchError):
    """The operator asked the run to end; the drives were stopped."""

    exit_code = EXIT_INTERRUPTED


class CycleObserver(Protocol):
    """Sees a run as it happens: recorder, progress display, an experiment's own code."""

    def sample(self, sample: CycleSample) -> None:
        """One cycle of the enabled bench; the object is reused, so copy what is kept."""


@dataclass(frozen=True)
class StepEvent:
    """A step change under test."""

    time_s: float
    path: str
    before: float
    after: float


class Bench:
    """Drives, load model, tension loop and twin of one config, running on its bus.

    Use it as a context manager::

        with Bench(config) as bench:
            bench.ramp("line_speed_m_s", 3.0, duration_s=4.0)
            bench.step("load.web.youngs_modulus_Pa", 10.5e9)
            bench.run(40.0)

    Entering starts the processes, configures the nodes and enables the drives; it raises BenchFaultError when
    something does not answer or does not come up. Time passes only in `cycle`, `run`, `ramp` and `wait_until`;
    what `set` changes acts from the next cycle on. Leaving brings the drives to a stop (by quick stop when it is
    left through an exception), ends the processes and leaves the bus.

    `tap` sees every frame on the bus; `work_folder` keeps the processes' config and logs (a temporary folder if not
    given); `participants`: who brings the simulated hardware and the twin, this bench unless said otherwise;
    `announce` is told what is being done, `journal` what the bench changes and no frame says; `may_idle`: in lockstep
    with simulated nodes any time may pass between two cycles (`hilbench.bench.lifecycle.idle`).
    A bench is the only master of its bus: one that has another is refused (UnusableInputError), with `force` only where
    a program of this machine says that it is the master. `bus_is_held`: whoever made this bench is inside
    `startup.held_bus` already.

    What an operator must know of a run that goes on collects in `notices`, counted by source and kind: warnings of the
    limits, EMCY messages, a tension loop that opens or closes. A twin that is lost ends no run: the loop holds, and the
    twin is taken back (after a start of its process, where the bench had started it) as soon as it is heard again.
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
        journal: Callable[[Change], None] = lambda change: None,
        may_idle: bool = False,
        force: bool = False,
        bus_is_held: bool = False,
    ) -> None:
        self.config = config
        self._phase: Literal["made", "running", "ended"] = "made"
        self.events: list[StepEvent] = []
        self.notices = Notices(announce)
        self.causes = Causes()
        self.timeliness = Timeliness((), config.cycle_time_s)  #: whose answers came late, since the drives were enabled
        self.line_speed_m_s = 0.0
        self.tension_set_point_N = config.tension_control.set_point_N
        self.interrupt_requested = False
        self.enabled = False
        self.stopping = False
        self.fault_time_s: float | None = None  #: when what led to the safe state was seen
        self.safe_state_problems: list[str] = []
        self.last = sample_type(config.signals)()
        self.nodes: Nodes
        self.exchange: CyclicExchange | None = None
        self.children: list[ChildProcess] = []
        self._observers = list(observers)
        self._tap = tap
        self._work_folder = work_folder
        self._participants = participants
        self._force = force
        self._bus_is_held = bus_is_held
        self._announce = announce
        self._journal = journal
        self._in_cycle = False
        self._heartbeat_s = config.master.heartbeat_ms * 1e-3
        self._may_idle = may_idle and idle.may_idle(config)
        self._resources = ExitStack()
        self._first_cycle = 0
        self._controlled_cycle: int | None = None  # whose twin data the controller has had
        web = config.machine.required_web
        self._load_model = LoadModel(config.machine, config.load, config.cycle_time_s)
        self._controller = TensionController.of_model(config.tension_control, config.machine)
        self._damping = SwingDamping(
            SwingPlant.of_model(config.machine, config.cycle_time_s),
            config.tension_control.swing_damping_ratio,
            web.youngs_modulus_Pa,
        )
        limits = config.safety.limits
        self._limits = LimitWatch(limits, web.youngs_modulus_Pa, config.cycle_time_s)
        self._saturation = SaturationWatch(config)
        self._operator = OperatorObjects(config, self.get, self._may_change)
        self._operator_speed_m_s: float | None = None  # where the line speed goes that an operator asked for
        self._ramped = ""  # the quantity that a ramp of the experiment moves
        self._twin: TwinConnection
        self._supervisor: ChildProcess | None = None
        self._controller_state = ControllerState.ERROR_ACTIVE
        self._strain_prev = config.machine.upstream_strain
        self._tension_next_N = config.machine.boundary.downstream_tension_N

    # -- start and end -----------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        if self._phase != "made":
            raise BenchNotRunningError(f"the bench {_WHERE[self._phase]}, expected a new Bench for each 'with'")
        try:
            self._announce("prepare the model (compiled on first use)")
            self._load_model.warm_up()
            if not self._bus_is_held:
                self._resources.enter_context(held_bus(self.config, self._participants, force=self._force))
            started = self._resources.enter_context(
                bring_up(
                    self.config,
                    tap=self._tap,
                    work_folder=self._work_folder,
                    participants=self._participants,
                    announce=self._announce,
                )
            )
            participants = (*map(started.nodes.sender, started.nodes.drives), started.nodes.twin_name)
            self.timeliness = Timeliness(participants, self.config.cycle_time_s)
            self.nodes, self.exchange, self.children = started.nodes, started.exchange, started.children
            self._phase = "running"
            self._supervisor = started.supervisor
            for warning in started.warnings:
                self._note("realtime", warning)
            self._twin = TwinConnection(
                self.config,
                started.nodes,
                started.exchange,
                next((child for child in started.children if child.name == TWIN), None),
                lambda text: self._note("twin", text),
                self._journal,
            )
            self._announce("enable drives")
            self._enable()
            if self._may_idle:
                stay_alive = partial(self._stay_alive, started.exchange)
                self._resources.enter_context(idle.kept_alive(stay_alive, self._heartbeat_s))
        except BaseException as error:
            try:
                self._safe_stop(error)
            finally:
                self._phase = "ended"
                self._resources.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                try:
                    self._announce("disable drives")
                    self._disable()
                except BaseException as failure:
                    self._safe_stop(failure)
                    raise
            else:
                try:
                    self._announce("quick stop")
                finally:  # who can't be told must not keep the drives from being stopped
                    self._safe_stop(error)
        finally:
            self._phase = "ended"
            self._resources.close()

    def _enable(self) -> None:
        for drive in self.nodes.drives:
            drive.request(DriveGoal.ENABLED)
        while not all(drive.reached for drive in self.nodes.drives):
            self._exchange_once()
        self._check_virtual_axes()
        self.enabled = True
        self._first_cycle = self._running().timing.cycles + 1
        self._journal(Change(self._first_cycle - 1, "enabled"))

    def _check_virtual_axes(self) -> None:
        """Ask the virtual axes by SDO whether they followed; in real time SYNC goes on meanwhile."""
        if self.config.pace == "lockstep":
            self.nodes.check_virtual_axes_enabled()
            return
        with ThreadPoolExecutor(1) as pool:
            check = pool.submit(self.nodes.check_virtual_axes_enabled)
            while not check.done():
                self._exchange_once()
            check.result()

    def _disable(self) -> None:
        self.stopping = True
        self._journal(Change(self._running().timing.cycles, "stopping"))
        self._slow_down()
        self.enabled = False
        self._load_model.stop()
        # The pull of the web has just gone: the axes take that up before they are let go.
        for _ in range(round(_SETTLE_S / self.config.cycle_time_s)):
            self._exchange_once()
        for drive in self.nodes.drives:
            drive.request(DriveGoal.DISABLED)
        while not all(drive.reached for drive in self.nodes.drives):
            self._exchange_once()

    def _slow_down(self) -> None:
        """An experiment may end at speed: a line that is let go must not stop within a cycle."""
        step_m_s = self.config.safety.quick_stop_m_s2 * self.config.cycle_time_s
        while self.line_speed_m_s:
            left_m_s = max(0.0, abs(self.line_speed_m_s) - step_m_s)
            self.line_speed_m_s = copysign(left_m_s, self.line_speed_m_s) if left_m_s else 0.0
            self._exchange_once()
            self._follow_web(self.last)

    def _safe_stop(self, reason: BaseException | None) -> None:
        """Quick stop, as far as the bus still carries it. What fails here is kept in `safe_state_problems`: the
        drives' own supervision of the bench's heartbeat stops them then."""
        self.fault_time_s = self.time_s
        if isinstance(reason, BenchFaultError) and not isinstance(reason, EmergencyStopError):
            cause = self.causes.first(self.time_s, str(reason))
            if cause:
                reason.add_cause(cause)
        self.enabled, self.stopping = False, True
        self._load_model.stop()
        if self.exchange is None:
            return
        began_cycle = self.exchange.timing.cycles
        try:
            try:
                if not isinstance(reason, EmergencyStopError):
                    self._quick_stop(self.exchange)
                    return
            except EmergencyStopError:
                pass  # while it was stopping: the nodes have left OPERATIONAL now
            self._confirm_stopped(self.exchange, self.nodes.drives)
        except HilbenchError as error:
            self.safe_state_problems.append(f"quick stop not confirmed: {error}")
        except Exception as error:  # nobody foresaw it: what is left is the way that needs least
            self.safe_state_problems.append(f"quick stop not confirmed: {self._unexpected(error)}")
            self._emergency_stop(self.exchange)
        finally:
            self._journal_stop(began_cycle)

    def _emergency_stop(self, exchange: CyclicExchange) -> None:
        try:
            exchange.emergency_stop()
            self._confirm_stopped(exchange, self.nodes.drives)
        except Exception as error:
            known = isinstance(error, HilbenchError)
            said = str(error) if known else self._unexpected(error)
            self.safe_state_problems.append(f"emergency stop not confirmed: {said}")

    def _unexpected(self, error: Exception) -> str:
        return unexpected(error, self._work_folder / TRACEBACK_FILE if self._work_folder else None)

    def _quick_stop(self, exchange: CyclicExchange) -> None:
        """No drive is vital any more: who does not answer must not keep the others from being stopped."""
        exchange.expect([replace(pdo, vital=False) for pdo in self.nodes.expected_pdos() if pdo.vital])
        self.nodes.twin_is_not_waited_for()

        def silent(drive: Drive) -> bool:
            return self.nodes.sender(drive) in exchange.silent

        quick_stop(self.nodes.drives, silent, self._exchange_once, self.config.cycle_time_s)
        missing = [drive for drive in self.nodes.drives if silent(drive)]
        if missing:
            self._confirm_stopped(exchange, missing)

    def _journal_stop(self, cycle: int) -> None:
        try:
            self._journal(Change(cycle, "stopping"))
        except BenchFaultError as error:  # a full disk must not come between the drives and their stop
            self.safe_state_problems.append(str(error))
        except Exception as error:
            self.safe_state_problems.append(self._unexpected(error))

    def _confirm_stopped(self, exchange: CyclicExchange, drives: Sequence[Drive]) -> None:
        """Ask drives that send no PDOs any more; SYNC goes on, because simulated time does with it."""
        exchange.expect([])

        def cycle() -> None:
            exchange.exchange([])
            exchange.discard_waiting()

        confirm_stopped(drives, self.nodes.read_statusword, cycle, self.config.cycle_time_s)

    # -- time --------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Experiment time: of the last sample, counted from the first cycle with all drives enabled."""
        return self.last.t_s

    def experiment_time_s(self, cycle: int) -> float:
        """Experiment time of a cycle, counted as in `CycleSample`; negative before the drives were enabled."""
        return (cycle - self._first_cycle) * self.config.cycle_time_s

    def cycle(self) -> CycleSample:
        """Run one cycle: set points and SYNC out, measurements in.

        Raises BenchFaultError on faults and limits; BenchNotRunningError before the bench was entered and once it was
        left, as everything that takes or changes something of it.
        """
        self._running()
        self._in_cycle = True
        try:
            return self._cycle()
        finally:
            self._in_cycle = False

    def _stay_alive(self, exchange: CyclicExchange) -> None:
        """From another thread. A cycle that hangs is for the supervisor."""
        if not self._in_cycle:
            exchange.stay_alive(self._heartbeat_s)

    def _cycle(self) -> CycleSample:
        if self.interrupt_requested:
            raise InterruptedByOperatorError("interrupted, drives were stopped")
        self._follow_operator()
        self._twin.before_cycle()
        self._look_after_supervisor()
        self._exchange_once()
        sample = self.last
        self._look_at_lateness(sample)
        self._follow_web(sample)
        self._look_at_controller()
        self._read_emergencies()
        for warning in self._limits.update(sample):
            self._note("limits", warning, kind=warning.partition(" is ")[0])
        for kind, text in self._saturation.update(sample):
            self._note("saturation", text, kind=kind)
        for observer in self._observers:
            observer.sample(sample)
        return sample

    def _look_at_lateness(self, sample: CycleSample) -> None:
        twin_age = 0 if self._twin.away else sample.twin_age_cycles
        self.timeliness.update((*self.nodes.ages_cycles(), twin_age))
        trouble = self.timeliness.trouble()
        if trouble:
            self.causes.holds(self.time_s, "late samples", trouble)

    def _look_after_supervisor(self) -> None:
        supervisor = self._supervisor
        if supervisor is not None and self._running().timing.cycles % _LOOK_CYCLES == 0:
            supervisor.check()

    def _look_at_controller(self) -> None:
        """Many broken-off frames: still a bus, but not for long."""
        state = self._running().controller
        if state is not self._controller_state:
            self._controller_state = state
            self._note("bus", f"the bench's CAN controller is {state.value}")

    def _note(self, source: str, text: str, *, kind: str = "", count: int = 1) -> None:
        self.notices.note(self.time_s, source, text, kind=kind, count=count)

    def _look_at_foreign_frames(self) -> None:
        """Somebody else who sends as the bench or its nodes do, or changes them."""
        for foreign in self.nodes.foreign:
            self._note(f"foreign frames, {foreign.about}", foreign.text, count=foreign.count)
            if foreign.certain:
                self.causes.holds(self.time_s, "foreign frames", f"foreign frames, {foreign.about}: {foreign.text}")

    def _stop_on_foreign_frames(self) -> None:
        if self.config.safety.on_foreign_frames == "warn" or self.stopping:
            return
        for foreign in self.nodes.foreign:
            if foreign.certain:
                raise BenchFaultError(f"t = {self.time_s:.3f} s: foreign frames, {foreign.about}: {foreign.text}")

    def _read_emergencies(self) -> None:
        for emergency, count in self.nodes.emergencies.items():
            self._note(f"{emergency.node} (node {emergency.node_id})", str(emergency), kind=emergency.kind, count=count)
            if self._twin.away:  # works off what it has missed, and knows nothing of now
                continue
            if emergency.code in (Problem.WEB_BREAK, Problem.SLIP):
                self._twin.distrust(str(emergency))
            if emergency.code == Problem.WEB_BREAK and self.config.safety.on_web_break == "stop":
                raise BenchFaultError(f"t = {self.time_s:.3f} s: {emergency.node} reports a web break")

    def run(self, duration_s: float) -> None:
        """Run for a time, rounded to whole cycles. Raises UnusableValueError for what is no time of 0 or more."""
        duration_s = quantities.checked_duration_s("duration_s", duration_s)
        self._running()
        for _ in range(round(duration_s / self.config.cycle_time_s)):
            self.cycle()

    def ramp(self, path: str, to: float, duration_s: float) -> None:
        """Move a quantity linearly to `to` within `duration_s`, which is above 0.

        Raises as `set`, before anything moves; for a switch, and for a duration that is none, too.
        """
        path = quantities.checked_path(path, quantities.rampable_path)
        to = quantities.checked_value(path, to)
        duration_s = quantities.checked_duration_s("duration_s", duration_s, above_zero=True)
        cycles = max(1, round(duration_s / self.config.cycle_time_s))
        start = self.get(path)
        self._ramped = path
        try:
            for k in range(1, cycles + 1):
                self.set(path, start + (to - start) * k / cycles)
                self.cycle()
        finally:
            self._ramped = ""

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
        self._running()
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
        self._running()
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
        path = quantities.checked_path(path)
        self._running()
        if path == quantities.LINE_SPEED:
            return self.line_speed_m_s
        if path == quantities.TENSION_SET_POINT:
            return self.tension_set_point_N
        if quantities.is_of_load(path):
            return self._load_model.value(path)
        return self.nodes.hardware_effect(quantities.parse_effect_path(path))

    def set(self, path: str, value: float) -> None:
        """Give a quantity a value from the next cycle on.

        Raises UnusableValueError (a ValueError too) for an unknown path or a value it can't have.
        """
        value, before = quantities.checked_value(quantities.checked_path(path), value), self.get(path)
        exchange = self._running()
        if path == quantities.LINE_SPEED:
            self.line_speed_m_s = value
            self._operator_speed_m_s = None
        elif path == quantities.TENSION_SET_POINT:
            self.tension_set_point_N = value
        elif quantities.is_of_load(path):
            self._load_model.set(path, value)
        else:
            self.nodes.set_hardware_effect(quantities.parse_effect_path(path), value)
        self._journal(Change(exchange.timing.cycles, "set", path, value, before))

    def step(self, path: str, to: float) -> None:
        """`set`, noted as the event under test that metrics and report refer to. Raises as `set`."""
        to = quantities.checked_value(quantities.checked_path(path), to)
        self.events.append(StepEvent(self.time_s, path, self.get(path), to))
        self.set(path, to)

    def restart_twin(self) -> None:
        """Reset the twin under way: it finds motion, tension and E anew, and the tension loop stays open until then.

        In real time the bench goes on meanwhile; in lockstep the bus stands still.
        """
        self._running()
        self._twin.reset()
        while self._twin.returning:
            self.cycle()

    def use_synchronizer(self, method: str) -> None:
        """Let the twin go on with another method from its present E. Raises UnusableValueError for an unknown one."""
        if method not in METHODS:
            raise UnusableValueError(
                f"method {method!r}, expected one of {', '.join(METHODS)}{did_you_mean(str(method), METHODS)}"
            )
        self._running()
        self.nodes.use_synchronizer(list(METHODS).index(method) + 1)

    # -- what an operator asks for ------------------------------------------------------------------------

    def _may_change(self, path: str) -> bool:
        """Only while the experiment runs, and nothing that it moves itself just now."""
        return self.enabled and not self.stopping and path != self._ramped

    def _follow_operator(self) -> None:
        """Apply what was asked for; the line speed goes there at the rate at which the bench itself slows down."""
        for path, value in self._operator.changes():
            self._note("operator", f"{path} from {self.get(path):.6g} to {value:.6g}")
            if path == quantities.LINE_SPEED:
                self._operator_speed_m_s = value
            else:
                self.step(path, value)
        goal_m_s = self._operator_speed_m_s
        if goal_m_s is not None:
            left_m_s = goal_m_s - self.line_speed_m_s
            step_m_s = min(abs(left_m_s), self.config.safety.quick_stop_m_s2 * self.config.cycle_time_s)
            self.set(quantities.LINE_SPEED, self.line_speed_m_s + copysign(step_m_s, left_m_s))
            self._operator_speed_m_s = goal_m_s if step_m_s < abs(left_m_s) else None

    # -- one cycle ---------------------------------------------------------------------------------------

    def _exchange_once(self) -> None:
        exchange, sample = self._running(), self.last
        self._command()
        outgoing = self.nodes.encode(self._strain_prev, self._tension_next_N)
        received = exchange.exchange([*outgoing, *self._operator.answers()])
        self._operator.take(received)
        try:
            self.nodes.decode(received, exchange.before_sync)
        finally:
            self._look_at_foreign_frames()
        self._stop_on_foreign_frames()
        self.nodes.fill(sample)
        sample.cycle = exchange.timing.cycles
        sample.twin_age_cycles = self._twin.age_cycles(sample.cycle)
        sample.t_s = self.experiment_time_s(sample.cycle)
        sample.F_ref_N = self.tension_set_point_N
        sample.bus_bits = exchange.last_bits
        sample.strain_prev, sample.F_next_N = self._strain_prev, self._tension_next_N

    def _running(self) -> CyclicExchange:
        if self._phase != "running" or self.exchange is None:
            raise BenchNotRunningError(
                f"the bench {_WHERE[self._phase]}, expected 'with Bench(…) as bench:' around this"
            )
        return self.exchange

    def _command(self) -> None:
        """Set points of this cycle from the last sample."""
        nodes, sample = self.nodes, self.last
        if not self.enabled:
            self._damping.reset()
            nodes.command([0.0] * len(nodes.axes), [0.0] * len(nodes.load_motors))
            return
        sample.loop_closed = int(self._twin.loop_closed(sample))
        since_s = self._since_controlled_s(sample)
        if sample.loop_closed:
            v1_m_s = self._controller.velocity(
                self.line_speed_m_s, self.tension_set_point_N, sample.F_sim_N, sample.E_sim_Pa, since_s
            )
            self._damping.use_modulus(sample.E_sim_Pa)
        else:
            v1_m_s = self._controller.hold(self.line_speed_m_s, self.tension_set_point_N, self.config.cycle_time_s)
        v1_m_s += self._damping.velocity(sample.x1_m, sample.x2_m)
        sample.v1_cmd_m_s, sample.v2_cmd_m_s = v1_m_s, self.line_speed_m_s
        nodes.command((v1_m_s, self.line_speed_m_s), (sample.tau_load_cmd_Nm,))

    def _since_controlled_s(self, sample: CycleSample) -> float:
        """The time that the twin's data have gone on since the controller's last step: none while they are repeated."""
        told_cycle, before = sample.cycle - sample.twin_age_cycles, self._controlled_cycle
        self._controlled_cycle = told_cycle
        cycles = 1 if before is None else min(max(told_cycle - before, 0), _MOST_CYCLES_AT_ONCE)
        return cycles * self.config.cycle_time_s

    def _follow_web(self, sample: CycleSample) -> None:
        web = self._load_model.web
        sample.tau_load_cmd_Nm = self._load_model.update(
            sample.x1_m, sample.x2_m, sample.v2_m_s, late=self.nodes.axes_late
        )
        sample.F_true_N, sample.strain_true = self._load_model.tension_N, self._load_model.strain
        sample.E_true_Pa = web.effective_modulus_Pa
