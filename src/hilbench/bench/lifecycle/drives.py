"""The drives of a bench: enabled and disabled in order, or brought to the safe state by quick stop, and confirmed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from math import ceil

from hilbench.bench.cycle import BenchCycle
from hilbench.bench.operator.operator import Operator
from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.cia402.drive import Drive, DriveGoal
from hilbench.cia402.state_machine import POWERED, STATUS_TARGET_REACHED, State, decode_statusword
from hilbench.errors import BenchFaultError, BusError, EmergencyStopError, HilbenchError
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.nodes import Nodes

#: Every drive is commanded to stop in so many cycles, a silent one as well: it may still receive, and a frame can be
#: lost.
_REPEATED_CYCLES = 3
#: Cycles between two questions to the drives while they stop after an emergency stop.
_ASK_EVERY = 25


def quick_stop(
    drives: Sequence[Drive], silent: Callable[[Drive], bool], exchange: Callable[[], object], cycle_s: float
) -> None:
    """Quick stop every drive and run cycles until all that answer (not `silent`) stand still.

    Faults of single drives don't keep the others from being stopped. Raises BenchFaultError, naming the drives, when
    one has not stopped within its time-outs, or the bus is lost.
    """
    for drive in drives:
        drive.request(DriveGoal.QUICK_STOP)
    longest_s = max(drive.settings.time_out_s + drive.settings.ramp_time_out_s for drive in drives)
    problem = "no fault was reported"
    for cycle in range(round(longest_s / cycle_s)):
        if cycle >= _REPEATED_CYCLES and all(drive.reached or silent(drive) for drive in drives):
            break
        try:
            exchange()
        except (BusError, EmergencyStopError):
            raise
        except BenchFaultError as error:
            problem = str(error)
    else:
        late = ", ".join(drive.settings.name for drive in drives if not drive.reached)
        raise BenchFaultError(f"{late} still not stopped; {problem}")


def confirm_stopped(
    drives: Sequence[Drive], statusword: Callable[[Drive], int], exchange: Callable[[], object], cycle_s: float
) -> None:
    """Run cycles until drives that send no PDOs (after an emergency stop) report by SDO that they have stopped.

    Raises BenchFaultError naming the drives that have not within their time-out, or do not answer.
    """
    moving = list(drives)
    longest_s = max(drive.settings.ramp_time_out_s for drive in drives)
    for cycle in range(round(longest_s / cycle_s)):
        exchange()
        if cycle % _ASK_EVERY == 0:
            moving = [drive for drive in moving if not _has_stopped(statusword(drive))]
            if not moving:
                exchange()  # the last answers belong in the trace
                return
    raise BenchFaultError(f"{', '.join(drive.settings.name for drive in moving)} still not stopped")


def _has_stopped(statusword: int) -> bool:
    state = decode_statusword(statusword)
    if state is State.QUICK_STOP_ACTIVE:
        return bool(statusword & STATUS_TARGET_REACHED)
    return state not in POWERED


#: Time for the axes to stand still again after the load motor was disabled.
_SETTLE_S = 0.3


class Drives:
    """Enables and stops the drives. `crash_report`: one line of an unexpected exception.

    In step (`Exchange.in_step`) no SYNC is sent during an SDO request, in real time it continues.
    """

    def __init__(
        self,
        state: BenchState,
        nodes: Nodes,
        exchange: Exchange,
        cycle: BenchCycle,
        *,
        crash_report: Callable[[Exception], str],
    ) -> None:
        self._state = state
        self._nodes = nodes
        self._exchange = exchange
        self._cycle = cycle
        self._unexpected = crash_report
        self._was_enabled = False
        #: Axes that their drives did not hold any more as the others were brought to rest, with what is known of it.
        self.coasting: dict[str, str] = {}

    def enable(self) -> None:
        """Enable all; the experiment's time begins. Raises BenchFaultError when one does not come up."""
        self._bring_to(DriveGoal.ENABLED)
        self._check_virtual_axes()
        state = self._state
        state.enabled = self._was_enabled = True
        state.first_cycle = self._exchange.timing.cycles + 1
        state.journal(Change(state.first_cycle - 1, "enabled"))

    def _bring_to(self, goal: DriveGoal) -> None:
        for drive in self._nodes.drives:
            drive.request(goal)
        while not all(drive.reached for drive in self._nodes.drives):
            self._cycle.exchange()

    def _check_virtual_axes(self) -> None:
        """Check by SDO that the virtual axes are enabled."""
        if self._exchange.in_step:
            self._nodes.check_virtual_axes_enabled()
            return
        with ThreadPoolExecutor(1) as pool:
            check = pool.submit(self._nodes.check_virtual_axes_enabled)
            while not check.done():
                self._cycle.exchange()
            check.result()

    def disable(self, operator: Operator) -> None:
        """Disable all drives, from standstill: an experiment may end at speed, and must not stop within a cycle."""
        state = self._state
        state.stopping = True
        state.journal(Change(self._exchange.timing.cycles, "stopping"))
        for _ in operator.slow_down():
            self._cycle.exchange()
        state.enabled = False
        # The load's torque has just vanished: the axes take that up before they are disabled.
        for _ in range(round(_SETTLE_S / state.cycle_s)):
            self._cycle.exchange()
        self._bring_to(DriveGoal.DISABLED)

    def stop(self, reason: BaseException | None) -> None:
        """Quick stop, as far as the bus still carries it; after an emergency stop see that all have stopped.

        What fails here is kept in `safe_state_problems`: the drives' own supervision of the bench's heartbeat stops
        them then.
        """
        began_cycle = self._exchange.timing.cycles
        problems = self._state.safe_state_problems
        try:
            try:
                if not isinstance(reason, EmergencyStopError):
                    self._stop_together()
                    self._quick_stop()
                    return
            except EmergencyStopError:
                pass  # while it was stopping: the nodes have left OPERATIONAL now
            self._confirm_stopped(self._nodes.drives)
        except HilbenchError as error:
            problems.append(f"quick stop not confirmed: {error}")
        except Exception as error:  # unexpected: what is left is the stop that needs least
            problems.append(f"quick stop not confirmed: {self._unexpected(error)}")
            self._emergency_stop()
        finally:
            self._journal_stop(began_cycle)

    def _stop_together(self) -> None:
        """Bring the rollers of a line to rest in the ratio of their speeds, which keeps the strain of every span.

        The load motors continue to emulate the web meanwhile. What fails here is left to the quick stop: a
        fault of one drive must not keep the others from stopping in ratio.
        """
        state, config = self._state, self._nodes.config
        names = list(config.drives)
        commands = {name: getattr(state.sample, f"v{axis}_cmd_m_s", 0.0) for axis, name in enumerate(names, 1)}
        fastest_m_s = max(map(abs, commands.values()))
        if not (config.stops_together and self._was_enabled and fastest_m_s > 0.0):
            return
        self._expect_whoever_answers()
        axes = zip(names, self._nodes.axes, strict=True)
        moving = {name: drive for name, drive in axes if commands[name]}
        timing = self._exchange.timing
        torque_axes = {names[axis - 1] for axis in config.shape.torqued}  # their tasks go on, by `speed_share`
        cycles = ceil(fastest_m_s / (config.quick_stop_per_s2 * state.cycle_s))
        state.enabled = True
        try:
            for left in range(cycles - 1, -1, -1):
                self._look_who_coasts(moving)
                before, state.speed_share = timing.cycles, left / cycles
                speeds = {name: speed * left / cycles for name, speed in commands.items() if name not in torque_axes}
                try:
                    self._cycle.exchange(speeds)
                except (BusError, EmergencyStopError):
                    raise
                except BenchFaultError:  # the quick stop reports the drive that it is about
                    if timing.cycles == before:  # nothing was sent: the drives would go on as they are
                        return
        except HilbenchError:
            raise
        except Exception as error:  # unexpected: the drives' own ramps need nothing of the machine's tasks
            state.safe_state_problems.append(self._unexpected(error))
        finally:
            state.enabled = False

    def _look_who_coasts(self, moving: Mapping[str, Drive]) -> None:
        for name, drive in moving.items():
            if self._nodes.sender(drive) in self._exchange.silent:
                self.coasting[name] = f"{drive.settings.name} does not answer, and coasts or stops by itself"
            elif not drive.feedback.powered:
                self.coasting[name] = f"{drive.settings.name} coasts, as its drive is off"

    def _expect_whoever_answers(self) -> None:
        """Make no drive vital: a silent one must not keep the others from being stopped."""
        self._exchange.expect_drives(vital=False)
        self._nodes.twin_is_not_waited_for()

    def _quick_stop(self) -> None:
        """Command it, and see that all have stopped."""
        nodes, exchange = self._nodes, self._exchange
        self._expect_whoever_answers()

        def silent(drive: Drive) -> bool:
            return nodes.sender(drive) in exchange.silent

        quick_stop(nodes.drives, silent, self._cycle.exchange, self._state.cycle_s)
        missing = [drive for drive in nodes.drives if silent(drive)]
        if missing:
            self._confirm_stopped(missing)

    def _emergency_stop(self) -> None:
        try:
            self._exchange.emergency_stop()
            self._confirm_stopped(self._nodes.drives)
        except Exception as error:
            known = isinstance(error, HilbenchError)
            text = str(error) if known else self._unexpected(error)
            self._state.safe_state_problems.append(f"emergency stop not confirmed: {text}")

    def _journal_stop(self, cycle: int) -> None:
        try:
            self._state.journal(Change(cycle, "stopping"))
        except BenchFaultError as error:  # a full disk must not come between the drives and their stop
            self._state.safe_state_problems.append(str(error))
        except Exception as error:
            self._state.safe_state_problems.append(self._unexpected(error))

    def _confirm_stopped(self, drives: Sequence[Drive]) -> None:
        """Confirm by SDO the stop of drives that send no PDOs any more; SYNC continues: simulated time needs it."""
        self._exchange.expect_nobody()
        confirm_stopped(drives, self._nodes.read_statusword, self._exchange.sync_only, self._state.cycle_s)
