"""The tension loop as a task: axis 1 by the controller while the twin can be trusted, by the ratio of speeds else."""

from __future__ import annotations

from hilbench.bench.state import Reports, TwinState
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.swing_damping import SwingDamping
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.bench.tasks.tension_control import TensionController
from hilbench.bench.tasks.twin_trust import TwinTrust
from hilbench.exchange.exchange import Inputs
from hilbench.topology.quantities import TENSION_SET_POINT
from hilbench.topology.sample import CycleSample

#: Cycles of late data of the twin that the tension controller makes up for in one step.
_MOST_CYCLES_AT_ONCE = 10


class TensionTask(CyclicTask):
    """Velocity of `drive` from the simulated tension, with the damping of the swing added.

    `set_point_N` is settable under way; `line_speed`: the reference that the axis downstream follows.
    """

    def __init__(
        self,
        drive: str,
        line_speed: Reference,
        set_point_N: float,
        controller: TensionController,
        damping: SwingDamping,
        trust: TwinTrust,
        twin: TwinState,
        reports: Reports,
        cycle_s: float,
    ) -> None:
        self._drive = drive
        self._line_speed = line_speed
        self._set_point_N = set_point_N
        self._controller = controller
        self._damping = damping
        self._trust = trust
        self._twin = twin
        self._reports = reports
        self._cycle_s = cycle_s
        self._controlled_cycle: int | None = None  # whose twin data the controller has had
        self._was_closed: bool | None = None  # None before it was closed for the first time

    def owns(self, path: str) -> bool:
        """Whether it is the set-point."""
        return path == TENSION_SET_POINT

    def value(self, path: str) -> float:
        """The set-point, N."""
        return self._set_point_N

    def set(self, path: str, value: float) -> None:
        """Another set-point, N."""
        self._set_point_N = value

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Velocity of the axis from the last sample."""
        closed = self._is_closed(sample)
        sample.loop_closed = int(closed)
        speed_m_s, since_s = self._line_speed.present, self._since_controlled_s(sample)
        if closed:
            velocity_m_s = self._controller.velocity(
                speed_m_s, self._set_point_N, sample.F_sim_N, sample.E_sim_Pa, since_s
            )
            self._damping.use_modulus(sample.E_sim_Pa)
        else:
            velocity_m_s = self._controller.hold(speed_m_s, self._set_point_N, self._cycle_s)
        velocity_m_s += self._damping.velocity(sample.x1_m, sample.x2_m)
        sample.v1_cmd_m_s = outputs[self._drive] = velocity_m_s

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Record the set-point."""
        sample.F_ref_N = self._set_point_N

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The web is at rest, strained as upstream."""
        self._damping.reset()
        sample.F_ref_N = self._set_point_N

    def _is_closed(self, sample: CycleSample) -> bool:
        """Whether the loop is closed on the twin's data in `sample`; that it opens or closes again is reported."""
        if self._twin.fresh(sample):
            closed = self._trust.update(sample)
        else:
            closed = False
            self._trust.forget(self._twin.why)
        if self._was_closed and not closed:
            self._reports.note("twin", f"tension loop open, axis 1 follows the ratio of speeds: {self._trust.doubt}")
        elif closed and self._was_closed is False:
            self._reports.note("twin", "tension loop closed again: the twin is synchronized")
        if closed or self._was_closed is not None:
            self._was_closed = closed
        return closed

    def _since_controlled_s(self, sample: CycleSample) -> float:
        """The time that the twin's data have gone on since the controller's last step: none while they are repeated."""
        reported_cycle, before = sample.cycle - sample.twin_age_cycles, self._controlled_cycle
        self._controlled_cycle = reported_cycle
        cycles = 1 if before is None else min(max(reported_cycle - before, 0), _MOST_CYCLES_AT_ONCE)
        return cycles * self._cycle_s
