"""Quick stop and confirmation of the safe state."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hilbench.cia402.drive import Drive, DriveGoal
from hilbench.cia402.state_machine import POWERED, STATUS_TARGET_REACHED, State, decode_statusword
from hilbench.errors import BenchFaultError, BusError, EmergencyStopError

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
