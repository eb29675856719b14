"""The tension loop as a task: the axis before a span is set by the controller while the twin can be trusted, else by
the ratio of speeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf

import numpy as np

from hilbench.bench.state import BenchState
from hilbench.bench.tasks import tension_cycle as cycle
from hilbench.bench.tasks.task import MANY, CompiledStages, Outputs, StagedTask
from hilbench.bench.tasks.tension_feed_forward import FeedForwardTask
from hilbench.bench.tasks.tension_trust import TwinSignals, VirtualSensorSupervision
from hilbench.bench.tasks.web_entering_strain import EnteringStrain, entering_records, strains_around
from hilbench.compiled import load, of_record, record_at
from hilbench.control.web_line.strain_trajectory import TRAJECTORY
from hilbench.control.web_line.swing_damping import SwingDamping, SwingPlant
from hilbench.control.web_line.tension import CONTROLLER, tension_controller
from hilbench.cycle_program import CompiledStage, python_stage
from hilbench.exchange.exchange import Inputs
from hilbench.plant.web_line.sections import section_model
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_config import TensionControlConfig
from hilbench.topology.web_line_quantities import tension_set_point
from hilbench.topology.web_line_signals import tension_loop_words


class AxisTask(StagedTask):
    """Commands the speed of an axis, which the axis before it follows; its stages run after those of the axis behind.

    `speeds`: commanded web speeds for compiled callers, `SPEEDS` of `tension_cycle`.
    """

    def __init__(self) -> None:
        self.speeds = np.zeros(1, cycle.SPEEDS)

    @property
    def speed_m_s(self) -> float:
        """Commanded web speed, without the damping of the span after it."""
        return float(self.speeds["undamped"][0])

    @property
    def damped_m_s(self) -> float:
        """Commanded web speed, with that damping."""
        return float(self.speeds["damped"][0])


@dataclass(frozen=True, slots=True)
class LoopNames:
    """Names in a tension loop: the drive, its axis, the set-point's path, signals."""

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
        """Names in a span's loop; E is that of the nearest span at which it is estimated."""
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
            of_loop=tension_loop_words(k),
        )


class TensionTask(AxisTask):
    """Velocity of the axis before a span from the simulated tension, with the damping of the swing added.

    `set_point_N` can be set during the run; `leader`: the axis after the span; `trajectories`: web travel at the axes
    before and after the span, m, where that differs from the encoders'; feed-forward: its plan, and the strains of the
    web before and after the span.
    """

    def __init__(
        self,
        config: BenchConfig,
        state: BenchState,
        control: TensionControlConfig,
        drive: str,
        leader: AxisTask,
        trajectories: Callable[[CycleSample], tuple[float, float]] | None,
        plan: FeedForwardTask | None,
        entering: Sequence[EnteringStrain],
    ) -> None:
        super().__init__()
        self._trajectories, self.leader, self._plan, self._entering = trajectories, leader, plan, entering
        self._twin, self._reports = state.twin, state.reports
        self.names = LoopNames.of(drive, control.span, config.shape)  #: names of drive, path and signals
        model, cycle_s, section = section_model(config.web_line), config.cycle_time_s, self.names.axis
        strains, modulus_Pa = strains_around(config, control.span), model.youngs_modulus_Pa(section)
        of_loop = control.bandwidth_rad_per_s, control.correction_limit_m_s
        self._controller = tension_controller(*of_loop, model, section, strains)
        swing = SwingPlant.of_model(model, cycle_s, section, strains)
        self._damping = SwingDamping(swing, control.swing_damping_ratio, modulus_Pa)
        highest_N = config.safety.limits.tension_N.trip or inf
        self.trust = VirtualSensorSupervision(control, highest_N, cycle_s, self.names.twin)
        self.opened_s = -inf  #: when it was closed last, in experiment time
        figures = {
            "set_point_N": control.set_point_N,
            "modulus_Pa": modulus_Pa,  # E until the loop is closed
            "cycle_s": cycle_s,
            "pull_m_s": np.nan,
        }
        loop = of_record(cycle.LOOP, controlled_cycle=cycle.NEVER, closed=cycle.NEVER, **figures)
        self.loop = np.array([loop], cycle.LOOP)
        self._at, self.moved = self.loop[0], self.loop.view(np.recarray)[0]  #: moved: its standstill excitation
        load(cycle.run)

    def _on(self, sample: CycleSample) -> CompiledStage:
        """Make the compiled stage."""
        self._sample = sample
        names, kind, damping = self.names, type(sample), self._damping
        of_twin, ends = (names.twin.tension, names.twin.modulus), (names.before, names.behind)
        at = kind.places([names.closed, names.command, *of_twin, *ends, "twin_age_cycles", "cycle"]).view(cycle.AT)
        if self._trajectories:
            at["before"] = at["behind"] = cycle.NOWHERE
        arrays = cycle.LoopArrays(
            controller=self._controller,
            damping=damping.vector,
            coherence=damping.coherence,
            positions_m=damping.positions_m,
            loop=self.loop,
            speeds=self.speeds,
            leader=self.leader.speeds,
            values=sample.reals,
            words=sample.wholes,
            at=at,
            trust=self.trust.arrays(kind),
        )
        if self._plan is not None:
            entering, at = entering_records(kind, self._entering)
            arrays = arrays._replace(
                trajectory=self._plan.trajectory(names.axis).view(TRAJECTORY),
                entering=entering,
                entering_at=at,
                leads_m_s=self._plan.lead(names.axis),
            )
        self._stage = CompiledStage(cycle.run, cycle.JUDGE, arrays, fallback=self._decide)
        return self._stage

    @property
    def set_point_N(self) -> float:
        """The set-point without a probe's shift."""
        return float(self._at["set_point_N"])

    @property
    def goal_N(self) -> float:
        """Wanted tension, with a probe's shift."""
        return self.set_point_N + float(self._at["shift_N"])

    def shift_set_point(self, by_N: float) -> None:
        """Shift the set-point by a probe."""
        self._at["shift_N"] = by_N

    @property
    def modulus_Pa(self) -> float:
        """E of the web there, as it was known last."""
        return float(self._at["modulus_Pa"])

    def assume_modulus(self, modulus_Pa: float) -> None:
        """Set E for the ratio of speeds of an open loop, in place of the twin's."""
        self._at["modulus_Pa"] = modulus_Pa
        record_at(self._controller, CONTROLLER).modulus_Pa = modulus_Pa

    @property
    def closed(self) -> bool:
        """True if the loop was closed in the last cycle."""
        return bool(self._at["closed"] == 1.0)

    def owns(self, path: str) -> bool:
        """True if it is the set-point."""
        return path == self.names.path

    def value(self, path: str) -> float:
        """The set-point, N."""
        return self.set_point_N

    def set(self, path: str, value: float) -> None:
        """Another set-point, N."""
        self._at["set_point_N"] = value

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Velocity of the axis from the last sample."""
        self._at["fresh"] = self._twin.fresh(sample)
        super().before(sample, outputs)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Record the set-point."""
        setattr(sample, self.names.set_point, self.goal_N)

    def _follow_reels(self, sample: CycleSample) -> None:
        """Set the web travel at the ends of a section with a reel of measured radius there."""
        if self._trajectories is not None:
            self._at["before_m"], self._at["behind_m"] = self._trajectories(sample)

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage of the loop, and Python's at a reel of measured radius; the set-point stays as it is."""

        def cycles() -> int:
            fresh = self._twin.fresh(sample)
            shown = getattr(sample, self.names.set_point) == self.goal_N
            return MANY if fresh == bool(self._at["fresh"]) and shown else 0

        at_reels = [] if self._trajectories is None else [python_stage(partial(self._follow_reels, sample))]
        before, shown = [*at_reels, self._on(sample)], {self.names.drive: self.names.command}
        return CompiledStages(before=before, cycles=cycles, shown=shown)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The web is at rest, strained as upstream."""
        self._damping.reset()
        setattr(sample, self.names.set_point, self.set_point_N)

    def _decide(self, code: int) -> bool:
        """Handle an event of the compiled cycle, then run its next stage."""
        sample = self._sample
        if code == cycle.STALE:
            self.trust.forget(self._twin.why)
        elif code < cycle.STALE:
            self.trust.doubts(code, sample)
        self._look_whether_closed()
        self._stage.function(cycle.CONTROL, self._stage.table)
        return True

    def _look_whether_closed(self) -> None:
        """Open or close the loop by the trust in the twin, and report it."""
        closed, was_closed = self.trust.trusted, self._at["closed"]
        loop, axis = self.names.of_loop, self.names.axis
        if was_closed == 1.0 and not closed:
            self.opened_s = self._sample.t_s
            self._reports.note("twin", f"{loop} open, axis {axis} follows the ratio of speeds: {self.trust.doubt}")
        elif closed and was_closed == 0.0:
            self._reports.note("twin", f"{loop} closed again: the twin is synchronized")
        if closed or was_closed != cycle.NEVER:
            self._at["closed"] = closed
