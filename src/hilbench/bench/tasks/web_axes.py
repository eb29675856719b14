"""Axes of a line that have no loop of their own: their velocities, compiled."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CompiledStages
from hilbench.bench.tasks.tension_cycle import SPEEDS
from hilbench.bench.tasks.tension_feed_forward import FeedForwardTask
from hilbench.bench.tasks.tension_task import AxisTask
from hilbench.compiled import COUNT, TABLE, Reals, Wholes2, arrays_in, entry_point, load, record_type
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.topology.sample import CycleSample

#: Standstill excitation added to a speed, m/s: of the leading axis and its followers; of one axis, nan: none.
_EXCITATION = record_type("creep_m_s", "pull_m_s")


class _Arrays(NamedTuple):
    """What `_follow` works on: the line speed (1,), of which others have none; speeds of the axis after it, lead of
    this one (1,), its standstill excitation, its speeds, `reals` of a sample."""

    line_speed: Reals
    leader: Annotated[Any, SPEEDS]
    leads_m_s: Reals
    excitation: Annotated[Any, _EXCITATION]
    speeds: Annotated[Any, SPEEDS]
    values: Reals


@entry_point(COUNT, TABLE)
def _follow(command: int, table: Wholes2) -> int:
    """Run a cycle of an axis; `command`: place of its command in a sample."""
    a = arrays_in(table, _Arrays)
    if len(a.line_speed) > 0:
        a.speeds.undamped = a.speeds.damped = a.line_speed[0] + a.excitation.creep_m_s
        speed_m_s = a.speeds.undamped
    else:
        a.speeds.undamped, a.speeds.damped = a.leader.undamped, a.leader.damped
        speed_m_s = a.speeds.damped + a.leads_m_s[0]
    pull_m_s = a.excitation.pull_m_s
    a.values[command] = speed_m_s if np.isnan(pull_m_s) else speed_m_s + pull_m_s
    return CONTINUE


class WebAxis(AxisTask):
    """Axis whose velocity one compiled stage makes, from what it follows and the standstill excitation.

    The last axis follows the line speed. One before a span without a controller turns as fast as the axis after it, so
    that the strain in the span is the one that enters it; with the damping of that axis, or the span would be stretched
    by it. `ahead`: its feed-forward.
    """

    def __init__(self, drive: str, axis: int, of: Reference | AxisTask, ahead: FeedForwardTask | None = None) -> None:
        super().__init__()
        self._drive, self._command = drive, f"v{axis}_cmd_m_s"
        if isinstance(of, Reference):
            self._line_speed, self._leader = of.vector, self.speeds
        else:
            self._line_speed, self._leader = np.zeros(0), of.speeds
        self._lead = ahead.lead(axis) if ahead else np.zeros(1)
        self._excitations = np.array([(0.0, np.nan)], _EXCITATION)
        self.moved = self._excitations.view(np.recarray)[0]  #: its standstill excitation
        load(_follow)

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage that makes the velocity command, m/s at the web."""
        arrays = _Arrays(
            self._line_speed, self._leader, self._lead, self._excitations, self.speeds, values=sample.reals
        )
        command = CompiledStage(_follow, type(sample).place(self._command), arrays, fallback=never)
        return CompiledStages(before=[command], shown={self._drive: self._command})
