"""The tension loop as a task: the axis before a span by the controller while the twin can be trusted, by the ratio of
speeds else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from operator import attrgetter
from typing import Protocol

from hilbench.bench.state import Reports, TwinState
from hilbench.bench.tasks import tension_cycle
from hilbench.bench.tasks.swing_damping import SwingDamping
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.bench.tasks.tension_control import TensionController
from hilbench.bench.tasks.tension_feed_forward import FeedForwardTask, StrainWay
from hilbench.bench.tasks.tension_trust import TwinSignals, TwinTrust
from hilbench.exchange.exchange import Inputs
from hilbench.topology.quantities import tension_set_point
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape

#: Cycles of late data of the twin that the tension controller makes up for in one step.
_MOST_CYCLES_AT_ONCE = 10


class Leader(Protocol):
    """An axis whose speed the axis before it follows."""

    @property
    def speed_m_s(self) -> float:
        """What it is to turn at, at the web, without what damps the span behind it."""

    @property
    def damped_m_s(self) -> float:
        """The same with that."""


class EnteringStrain(Protocol):
    """Strain of the web that may enter a span, as the twin has it."""

    def __call__(self, sample: CycleSample) -> float:
        """From what it has sent last."""


@dataclass(frozen=True)
class FeedForward:
    """What a loop has ahead of its controller; strains: of the web around the span; `leads`: of the rollers."""

    way: StrainWay
    strain_before: EnteringStrain
    strain_behind: EnteringStrain
    leads: FeedForwardTask


@dataclass(frozen=True, slots=True)
class LoopNames:
    """What is called what in a tension loop: the drive, the axis that it is, the set-point's path, signals."""

    drive: str
    axis: int
    span: int
    path: str
    twin: TwinSignals
    set_point: str
    closed: str
    command: str
    before: str  #: position of the axis before the span
    behind: str
    of_loop: str  #: for messages

    @classmethod
    def of(cls, drive: str, span: int, shape: Shape) -> LoopNames:
        """Those of a span's loop; E is that of the nearest span at which it is estimated."""
        k, known, axis = shape.numbered(span), shape.numbered(shape.shows(span)), shape.axis_before(span)
        return cls(
            drive=drive,
            axis=axis,
            span=span,
            path=tension_set_point(k),
            twin=TwinSignals(f"F{k}_sim_N", f"E{known}_sim_Pa", f"E{known}_sd_Pa"),
            set_point=f"F{k}_ref_N",
            closed=f"loop{k}_closed",
            command=f"v{axis}_cmd_m_s",
            before=f"x{axis}_m",
            behind=f"x{axis + 1}_m",
            of_loop=f"tension loop of span {k}" if k else "tension loop",
        )


class TensionTask(CyclicTask):
    """Velocity of the axis before a span from the simulated tension, with the damping of the swing added.

    `set_point_N` is settable under way; `leader`: the axis behind the span; `modulus_Pa`: E until the loop was closed
    (for `feed_forward`); `ways`: of the web at the axes before and behind the span, m, where that is not what the
    encoders tell.
    """

    def __init__(
        self,
        names: LoopNames,
        leader: Leader,
        set_point_N: float,
        controller: TensionController,
        damping: SwingDamping,
        trust: TwinTrust,
        twin: TwinState,
        reports: Reports,
        cycle_s: float,
        modulus_Pa: float = 0.0,
        feed_forward: FeedForward | None = None,
        ways: Callable[[CycleSample], tuple[float, float]] | None = None,
    ) -> None:
        self._ways = ways or attrgetter(names.before, names.behind)
        self._names = names
        self._leader = leader
        self._set_point_N = set_point_N
        self.set_point_shift_N = 0.0  #: of a probe
        self.pull_m_s: float | None = None  #: see `RestMovement`
        self._controller = controller  # keeps its vectors, as the next
        self._damping = damping
        self._table = tension_cycle.table(controller, damping)
        self._trust = trust
        self._twin = twin
        self._reports = reports
        self._cycle_s = cycle_s
        self._modulus_Pa = modulus_Pa
        self._ahead = feed_forward
        self._controlled_cycle: int | None = None  # whose twin data the controller has had
        self._was_closed: bool | None = None  # None before it was closed for the first time
        self._speed_m_s = self._damped_m_s = 0.0

    @property
    def speed_m_s(self) -> float:
        """What the axis is to turn at, without the damping."""
        return self._speed_m_s

    @property
    def damped_m_s(self) -> float:
        """With the damping."""
        return self._damped_m_s

    @property
    def names(self) -> LoopNames:
        """What is called what."""
        return self._names

    @property
    def span(self) -> int:
        """Number of the span whose tension is kept."""
        return self._names.span

    @property
    def set_point_N(self) -> float:
        """The set-point without a probe's shift."""
        return self._set_point_N

    @property
    def goal_N(self) -> float:
        """What the tension is to be: with a probe's shift."""
        return self._set_point_N + self.set_point_shift_N

    @property
    def modulus_Pa(self) -> float:
        """E of the web there, as it was known last."""
        return self._modulus_Pa

    @property
    def closed(self) -> bool:
        """Whether the loop was closed in the last cycle."""
        return bool(self._was_closed)

    def owns(self, path: str) -> bool:
        """Whether it is the set-point."""
        return path == self._names.path

    def value(self, path: str) -> float:
        """The set-point, N."""
        return self._set_point_N

    def set(self, path: str, value: float) -> None:
        """Another set-point, N."""
        self._set_point_N = value

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Velocity of the axis from the last sample."""
        names = self._names
        closed = self._is_closed(sample)
        setattr(sample, names.closed, int(closed))
        speed_m_s, since_s = float(self._leader.speed_m_s), self._since_controlled_s(sample)
        ahead, set_point_N, around_m_s = self._ahead, float(self.goal_N), nan
        if closed:
            self._modulus_Pa = getattr(sample, names.twin.modulus)
        if ahead is not None:
            set_point_N = ahead.way.tension_N(self._modulus_Pa)
            behind_m_s = self._leader.damped_m_s
            entering = ahead.strain_before if behind_m_s >= 0.0 else ahead.strain_behind
            around_m_s = ahead.way.velocity(behind_m_s, entering(sample))
        tension_N = modulus_Pa = 0.0
        if closed:
            tension_N, modulus_Pa = getattr(sample, names.twin.tension), self._modulus_Pa
            self._damping.use_modulus(modulus_Pa)
        else:
            since_s = self._cycle_s
        planned_m_s = ahead.way.shown_m_s if ahead is not None else 0.0
        now = speed_m_s, set_point_N, tension_N, modulus_Pa, since_s, around_m_s, *self._ways(sample), planned_m_s
        self._speed_m_s, damping_m_s = tension_cycle.step(closed, now, self._table)
        if self.pull_m_s is not None:
            damping_m_s = 0.0  # it would take the pull back
        self._damped_m_s = velocity_m_s = self._speed_m_s + damping_m_s
        if ahead is not None:
            velocity_m_s += ahead.leads.lead_m_s(names.axis)
        if self.pull_m_s is not None:
            velocity_m_s += self.pull_m_s
        outputs[names.drive] = velocity_m_s
        setattr(sample, names.command, velocity_m_s)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Record the set-point."""
        setattr(sample, self._names.set_point, self.goal_N)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The web is at rest, strained as upstream."""
        self._damping.reset()
        setattr(sample, self._names.set_point, self._set_point_N)

    def _is_closed(self, sample: CycleSample) -> bool:
        """Whether the loop is closed on the twin's data in `sample`; that it opens or closes again is reported."""
        if self._twin.fresh(sample):
            closed = self._trust.update(sample)
        else:
            closed = False
            self._trust.forget(self._twin.why)
        loop, axis = self._names.of_loop, self._names.axis
        if self._was_closed and not closed:
            self._reports.note("twin", f"{loop} open, axis {axis} follows the ratio of speeds: {self._trust.doubt}")
        elif closed and self._was_closed is False:
            self._reports.note("twin", f"{loop} closed again: the twin is synchronized")
        if closed or self._was_closed is not None:
            self._was_closed = closed
        return closed

    def _since_controlled_s(self, sample: CycleSample) -> float:
        """The time that the twin's data have gone on since the controller's last step: none while they are repeated."""
        reported_cycle, before = sample.cycle - sample.twin_age_cycles, self._controlled_cycle
        self._controlled_cycle = reported_cycle
        cycles = 1 if before is None else reported_cycle - before
        if cycles == 1:  # nearly always
            return self._cycle_s
        return min(max(cycles, 0), _MOST_CYCLES_AT_ONCE) * self._cycle_s
