"""Feed-forward of the tension loops in a cycle: `hilbench.control.web_line.feed_forward`, from the bench's signals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CompiledStages, Outputs, StagedTask
from hilbench.bench.tasks.tension_cycle import LOOP
from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Records,
    Vector,
    Wholes2,
    arrays_in,
    entry_point,
    load,
    record_type,
    records,
)
from hilbench.control.web_line.feed_forward import ROLLER, plan_leads, rollers_of
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, advance, strain_trajectory
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample

#: Of the task: a cycle, and the line's speed in the last one.
_OWN = record_type("cycle_s", "speed_m_s")


class _Arrays(NamedTuple):
    """What the plan is made of; after it in the table come the loops of the spans with a trajectory."""

    rollers: Annotated[Any, records(ROLLER)]
    trajectories: Annotated[Any, records(TRAJECTORY)]
    leads_m_s: Reals
    line_speed: Reals
    own: Annotated[Any, _OWN]


class _Loop(NamedTuple):
    loop: Annotated[Any, LOOP]


@entry_point(COUNT, TABLE)
def _plan(_: int, table: Wholes2) -> int:
    a, row = arrays_in(table, _Arrays), _LOOPS
    for k in range(len(a.trajectories)):
        if a.trajectories[k].per_s > 0.0:
            loop = arrays_in(table[row:], _Loop).loop
            advance(a.trajectories[k], loop.set_point_N + loop.shift_N, loop.modulus_Pa)
            row += 1
    speed_m_s = a.line_speed[0]
    acceleration_m_s2 = (speed_m_s - a.own.speed_m_s) / a.own.cycle_s
    a.own.speed_m_s = speed_m_s
    plan_leads(a.rollers, a.trajectories, acceleration_m_s2, a.leads_m_s)
    return CONTINUE


#: Row of the first loop.
_LOOPS = len(_Arrays._fields)


class Goal(Protocol):
    """Something that keeps a tension."""

    @property
    def loop(self) -> Records:
        """LOOP of `tension_cycle` (1,): wanted tension, and E of the web there."""


class FeedForwardTask(StagedTask):
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
        self._own, self._leads_m_s = np.array([(cycle_s, 0.0)], _OWN), np.zeros(model.axis_count)
        trajectories = np.zeros((model.axis_count - 1, TRAJECTORY.itemsize // 8))
        for span, rise_s in rises_s.items():
            of_web = model.span_length_m(span), model.section_m2(span), model.upstream_strain
            trajectories[span - 1] = strain_trajectory(rise_s, cycle_s, *of_web)
        self._spans = sorted(rises_s)
        self._at_rest = np.concatenate(rollers_of(model, cycle_s)), trajectories
        self._rollers, self._trajectories = (vector.copy() for vector in self._at_rest)
        load(_plan)

    def lead(self, axis: int) -> Vector:
        """Lead of an axis's command over its planned speed in this cycle, m/s (1,)."""
        return self._leads_m_s[axis - 1 : axis]

    def trajectory(self, axis: int) -> Vector:
        """`TRAJECTORY` of the span after an axis."""
        found: Vector = self._trajectories[axis - 1]
        return found

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage that advances the plan by a cycle."""
        rollers, trajectories = self._rollers.view(ROLLER), self._trajectories.reshape(-1).view(TRAJECTORY)
        own = _Arrays(rollers, trajectories, self._leads_m_s, self._line_speed.vector, self._own)
        loops = [_Loop(self._loops[span].loop) for span in self._spans]
        return CompiledStages(before=[CompiledStage(_plan, 0, (own, *loops), fallback=never)])

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Reset at rest: the web is strained as upstream, and the trajectories begin there."""
        self._own["speed_m_s"] = self._line_speed.present
        self._rollers[:], self._trajectories[:] = self._at_rest
        self._leads_m_s[:] = 0.0
