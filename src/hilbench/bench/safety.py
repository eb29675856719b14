"""Limits of a run, and the way to the safe state."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hilbench.bench.config import SafetyConfig
from hilbench.bench.sample import CycleSample
from hilbench.drives.drive import Drive, DriveGoal
from hilbench.errors import BenchFaultError, BusError, NoAnswerError

#: Cycles in a row without an answer after which a quick stop is not waited for any longer. The set points of the
#: stop were sent in each of them; drives that don't hear them stop by their own supervision.
_SILENT_CYCLES = 3


def check_limits(sample: CycleSample, limits: SafetyConfig) -> None:
    """Raise BenchFaultError when the simulated or the imitated tension leaves its range (NaN counts as outside)."""
    for name, tension_N in (("simulated", sample.F_sim_N), ("imitated", sample.F_true_N)):
        if not -1.0 <= tension_N <= limits.tension_limit_N:
            raise BenchFaultError(
                f"t = {sample.t_s:.3f} s: {name} tension {tension_N:.1f} N is outside 0 to {limits.tension_limit_N:g} N"
            )


def quick_stop(drives: Sequence[Drive], exchange: Callable[[], None], cycle_s: float) -> None:
    """Quick stop every drive and run cycles until all stand still.

    Faults of single drives don't keep the others from being stopped. Raises BenchFaultError, naming the drives,
    when one has not stopped within its time-outs, when a participant stays silent, or the bus is lost.
    """
    for drive in drives:
        drive.request(DriveGoal.QUICK_STOP)
    longest_s = max(drive.settings.time_out_s + drive.settings.ramp_time_out_s for drive in drives)
    silent_cycles, problem = 0, ""
    for _ in range(round(longest_s / cycle_s)):
        if all(drive.reached for drive in drives):
            return
        try:
            exchange()
            silent_cycles = 0
        except NoAnswerError as error:
            silent_cycles += 1
            if silent_cycles == _SILENT_CYCLES:
                raise
            problem = str(error)
        except BusError:
            raise
        except BenchFaultError as error:
            problem = str(error)
    late = ", ".join(drive.settings.name for drive in drives if not drive.reached)
    raise BenchFaultError(f"{late} still not stopped; {problem or 'no fault was reported'}")
