"""Feed-forward of the tension loops in a cycle: `hilbench.control.web_line.feed_forward`, from the bench's signals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CompiledStages, CyclicTask, Outputs
from hilbench.bench.tasks.tension_cycle import MODULUS_PA, SET_POINT_N, SHIFT_N
from hilbench.compiled import COUNT, TABLE, TABLE_WIDTH, Vector, entry_point, floats, table_of, viewed
from hilbench.control.web_line.feed_forward import ROLLER, plan_leads, rollers_of
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, advance, strain_trajectory
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample

# Rows of the table; after them the vector of the loop of each span with a trajectory.
_ROLLERS, _TRAJECTORIES, _LEADS_M_S, _LINE_SPEED, _OWN, _LOOPS = range(6)
#: Vector of the task: a cycle, s, and the line's speed in the last one.
_CYCLE_S, _SPEED_M_S = range(2)


@entry_point(COUNT, TABLE)
def _plan(_: int, table: NDArray[np.int64]) -> int:
    if len(table) == 0:
        return CONTINUE
    trajectories, row = viewed(floats(table, _TRAJECTORIES, (1,)), TRAJECTORY), _LOOPS
    for k in range(len(trajectories)):
        if trajectories[k].per_s > 0.0:
            loop = floats(table, row, (1,))
            advance(trajectories[k], loop[SET_POINT_N] + loop[SHIFT_N], loop[MODULUS_PA])
            row += 1
    own, speed_m_s = floats(table, _OWN, (1,)), floats(table, _LINE_SPEED, (1,))[0]
    acceleration_m_s2 = (speed_m_s - own[_SPEED_M_S]) / own[_CYCLE_S]
    own[_SPEED_M_S] = speed_m_s
    rollers = viewed(floats(table, _ROLLERS, (1,)), ROLLER)
    plan_leads(rollers, trajectories, acceleration_m_s2, floats(table, _LEADS_M_S, (1,)))
    return CONTINUE


class Goal(Protocol):
    """Something that keeps a tension."""

    @property
    def loop(self) -> Vector:
        """Vector of the loop as in `tension_cycle`: wanted tension, and E of the web there."""


class FeedForwardTask(CyclicTask):
    """Feed-forward plan of a cycle, before any speed command: set-point trajectories, and leads of the rollers.

    `loops`: tension loops by the number of the span, also those added later; `rises_s`: rise times of the trajectories
    of those spans that have one. The others count as having a constant tension.
    """

    def __init__(
        self,
        model: ModelParameters,
        cycle_s: float,
        line_speed: Reference,
        loops: Mapping[int, Goal],
        rises_s: Mapping[int, float],
    ) -> None:
        self._line_speed, self._loops = line_speed, loops
        self._own, self._leads_m_s = np.array([cycle_s, 0.0]), np.zeros(model.axis_count)
        trajectories = np.zeros((model.axis_count - 1, TRAJECTORY.itemsize // 8))
        for span, rise_s in rises_s.items():
            of_web = model.span_length_m(span), model.section_m2(span), model.upstream_strain
            trajectories[span - 1] = strain_trajectory(rise_s, cycle_s, *of_web)
        self._spans = sorted(rises_s)
        self._at_rest = np.concatenate(rollers_of(model, cycle_s)), trajectories
        self._rollers, self._trajectories = (vector.copy() for vector in self._at_rest)
        self._piece: CompiledStage | None = None
        _plan(0, np.zeros((0, TABLE_WIDTH), np.int64))  # compiled, or loaded, before a cycle waits for it

    def lead(self, axis: int) -> Vector:
        """Lead of an axis's command over its planned speed in this cycle, m/s (1,)."""
        return self._leads_m_s[axis - 1 : axis]

    def trajectory(self, axis: int) -> Vector:
        """`TRAJECTORY` of the span after an axis."""
        found: Vector = self._trajectories[axis - 1]
        return found

    @property
    def piece(self) -> CompiledStage:
        """Compiled stage: advance the plan by a cycle."""
        if self._piece is None:
            kept = [self._rollers, self._trajectories.reshape(-1), self._leads_m_s, self._line_speed.vector, self._own]
            kept += [self._loops[span].loop for span in self._spans]
            self._piece = CompiledStage(_plan, 0, table_of(kept), fallback=never, keeps=kept)
        return self._piece

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Advance the plan by a cycle."""
        self.piece()

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage that makes the plan of a cycle."""
        return CompiledStages(before=[self.piece])

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Reset at rest: the web is strained as upstream, and the trajectories begin there."""
        self._own[_SPEED_M_S] = self._line_speed.present
        self._rollers[:], self._trajectories[:] = self._at_rest
        self._leads_m_s[:] = 0.0
