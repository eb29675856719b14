"""State shared by the parts of a bench (lifecycle, cycle, operator, tasks)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from hilbench.bench.reports.change import Change
from hilbench.bench.reports.notice import Notices
from hilbench.errors import BenchFaultError, BenchNotRunningError, EmergencyStopError
from hilbench.exchange.exchange import Exchange
from hilbench.topology.sample import CycleSample

#: A condition that has not held for this time before the fault is no cause of it; later it counts as a new one.
_HELD_S = 2.0
#: What a message calls a bench that is not running (any more).
_WHERE = {"made": "has not been entered", "running": "has been entered already", "ended": "has been left"}


@dataclass(slots=True)
class _Condition:
    since_s: float
    until_s: float
    text: str


class Reports:
    """Reports of a running run: notices for the operator, and possible causes of a fault.

    The time of both is that of the last sample, experiment time in s. Causes are lasting conditions by kind, in the
    order in which they began: what was wrong before a fault is often the better place to look.
    """

    def __init__(self, sample: CycleSample, announce: Callable[[str], None]) -> None:
        self.notices = Notices(announce)
        self._conditions: dict[str, _Condition] = {}
        self._sample = sample

    def note(self, source: str, text: str, *, kind: str = "", count: int = 1) -> None:
        """Note an event for the operator, see `Notices.note`."""
        self.notices.note(self._sample.t_s, source, text, kind=kind, count=count)

    def condition(self, kind: str, text: str) -> None:
        """Report a condition that holds now and may cause a fault; `text` describes it as it is now."""
        time_s, known = self._sample.t_s, self._conditions.get(kind)
        if known is None or time_s - known.until_s > _HELD_S:
            self._conditions[kind] = _Condition(time_s, time_s, text)
        else:
            known.until_s, known.text = time_s, text

    def cause(self, fault: str) -> str:
        """Condition that began first of those that held until just now, with its time; "" for none, and where the text
        of the `fault` has it already."""
        time_s = self._sample.t_s
        lasting = [condition for condition in self._conditions.values() if time_s - condition.until_s <= _HELD_S]
        if not lasting:
            return ""
        first = min(lasting, key=lambda condition: condition.since_s)
        return "" if first.text in fault else f"from t = {first.since_s:.3f} s on: {first.text}"


@dataclass
class TwinState:
    """State of the bench's twin, kept by `hilbench.bench.tasks.twin_connection`."""

    away: bool = False  #: it is lost, or not taken back yet
    why: str = ""  #: why it was lost last
    started_cycle: int = 0  #: the SYNC before that which it counts as its first
    back_cycle: int = 0  #: in which it was taken back
    refusals: int | None = None  #: number of tension loops opened by `TensionWatch`; None: there is no watch

    def fresh(self, sample: CycleSample) -> bool:
        """True if the twin's data in a sample are current: one from before it was taken back may repeat old ones."""
        return not self.away and sample.cycle > self.back_cycle


@dataclass
class BenchState:
    """One bench from its making to its end."""

    cycle_s: float
    sample: CycleSample  #: of the last cycle; one object for all of them
    announce: Callable[[str], None]
    journal: Callable[[Change], None]
    phase: Literal["made", "running", "ended"] = "made"
    enabled: bool = False  #: the drives are, and the experiment's time advances
    stopping: bool = False
    #: Factor on the speeds that the tasks plan, while the axes are brought to rest in the ratio of these.
    speed_share: float = 1.0
    interrupt_requested: bool = False
    first_cycle: int = 0  #: number of the first cycle with all drives enabled
    fault_time_s: float | None = None  #: when what led to the safe state was seen
    safe_state_problems: list[str] = field(default_factory=list)
    twin: TwinState = field(default_factory=TwinState)
    exchange: Exchange | None = None
    warn: Callable[[str], None] | None = None  #: gets the notices, in the place of `announce`

    def __post_init__(self) -> None:
        self.reports = Reports(self.sample, self.warn or self.announce)

    def require_new(self) -> None:
        """Raise BenchNotRunningError for a bench that was entered before."""
        if self.phase != "made":
            raise BenchNotRunningError(f"the bench {_WHERE[self.phase]}, expected a new Bench for each 'with'")

    def running(self) -> Exchange:
        """The exchange with the nodes. Raises BenchNotRunningError before a bench was entered and once it was left."""
        if self.phase != "running" or self.exchange is None:
            where = _WHERE[self.phase]
            raise BenchNotRunningError(f"the bench {where}, expected 'with Bench(…) as bench:' around this")
        return self.exchange

    def experiment_time_s(self, cycle: int) -> float:
        """Experiment time of a cycle, counted as in `CycleSample`; negative before the drives were enabled."""
        return (cycle - self.first_cycle) * self.cycle_s

    def end(self, reason: BaseException | None) -> None:
        """The drives are to be stopped; a fault gets what may have led to it as its cause."""
        self.fault_time_s = self.sample.t_s
        if isinstance(reason, BenchFaultError) and not isinstance(reason, EmergencyStopError):
            cause = self.reports.cause(str(reason))
            if cause:
                reason.add_cause(cause)
        self.enabled, self.stopping = False, True
