"""A web that has torn, or is slack, in a section of a line with idlers, dancers, accumulators or reels.

All driven rollers behind a section together carry the difference of its tension and that behind the line, whatever is
between them. So what their torques and speeds say, beside what the line that is followed has, is the tension that the
section has in truth: where almost nothing is left of it, in two blocks running, the web has torn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from hilbench.estimation.plausibility import Problem
from hilbench.estimation.web_line.blocks import BLOCK_S
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans

#: Share of the tension below which a web has torn, and above which it is whole again.
_TORN, _WHOLE = 0.15, 0.3
#: Share below which nothing is learned, and for how long: a web that tears has this on its way, another one for good.
_DOUBTFUL, _DOUBT_S = 0.5, 0.15
#: Shares of the usual tension: least for a web to be taken for torn, and most of a slack one.
_LEAST, _SLACK = 0.125, 0.02
#: Speeds at either end of a block, of which the middle one counts: cycles are not of one length where time is real.
_ENDS: Final = 3
#: From when on: until then the line that is followed comes to the tensions that there are.
_SETTLED_S: Final = 0.5


class SectionWatch:
    """Of a line whose N driven rollers answer once a cycle. `told`: the span by whose number each section is told, by
    the axis before it."""

    def __init__(self, model: ModelParameters, cycle_s: float, told: Mapping[int, int]) -> None:
        before = axes_before_spans(model)
        self._model, self._cycle_s = model, cycle_s
        self._cycles = max(round(BLOCK_S / cycle_s), 2 * _ENDS)
        self._spans = {axis: [k for k, of in enumerate(before) if of == axis] for axis in told}
        axes = range(1, model.axis_count + 1)
        carried = [model.carries_web_load(axis) for axis in axes]
        #: Sections behind which every roller is loaded: of the others no torque tells the tension.
        self._seen = [axis for axis in told if all(carried[axis:])]
        self._told = told
        self._per_m = np.array([model.motor_rad_per_m(axis) for axis in axes])
        self._usual_N = [model.upstream_strain * model.stiffness_N(spans[-1] + 1) for spans in self._spans.values()]
        self.reset()

    def reset(self) -> None:
        """The web is let go."""
        self._time_s = 0.0
        self._low = dict.fromkeys(self._seen, False)  # in the block before
        self._torn = dict.fromkeys(self._seen, False)
        self._doubt_s = dict.fromkeys(self._seen, 0.0)
        self._slack = dict.fromkeys(self._told, False)
        self.interrupt()

    def interrupt(self) -> None:
        """A cycle is missing, or a torque says nothing: a new block begins."""
        self._collected = 0
        self._differences_Nm = np.zeros(len(self._per_m))
        self._promised_N = np.zeros(len(self._spans))
        self._tightest_N = np.zeros(len(self._spans))
        self._way_m: list[Vector] = []

    @property
    def problems(self) -> dict[int, Problem | None]:
        """What is wrong with each section, by the span by which it is told."""
        found: dict[int, Problem | None] = {}
        for axis, span in self._told.items():
            found[span] = Problem.SLACK if self._slack[axis] else None
            if self._torn.get(axis, False):
                found[span] = Problem.WEB_BREAK
        return found

    @property
    def doubtful(self) -> bool:
        """Whether something may be torn: what the torques say is nothing to learn from."""
        return any(self._torn.values()) or any(0.0 < doubt_s <= _DOUBT_S for doubt_s in self._doubt_s.values())

    def look(
        self, positions_m: Sequence[float], torques_Nm: Sequence[float], line: LineFollower, inertia_kg_m2: Vector
    ) -> None:
        """One cycle: of the driven rollers positions (N,) at the web and torques, beside the line that follows them;
        `inertia_kg_m2` (N,): at the motors."""
        self._time_s += self._cycle_s
        tensions_N = line.tension_N
        self._promised_N += [tensions_N[spans[-1]] for spans in self._spans.values()]
        self._tightest_N = np.maximum(self._tightest_N, [np.min(tensions_N[spans]) for spans in self._spans.values()])
        self._way_m.append(np.array(positions_m))
        speeds = line.v_m_s
        for axis, torque_Nm in enumerate(torques_Nm, 1):
            self._differences_Nm[axis - 1] -= torque_Nm + line.web_torque_Nm(axis, speeds.item(axis - 1))
        self._collected += 1
        if self._collected > self._cycles:
            self._judge(line, inertia_kg_m2)
            self.interrupt()

    def _judge(self, line: LineFollower, inertia_kg_m2: Vector) -> None:
        """A block is complete."""
        for axis, tightest_N, usual_N in zip(self._spans, self._tightest_N.tolist(), self._usual_N, strict=True):
            self._slack[axis] = tightest_N <= _SLACK * usual_N
        speeds = np.diff(np.array(self._way_m), axis=0) / self._cycle_s
        gained_m_s = np.median(speeds[-_ENDS:], axis=0) - np.median(speeds[:_ENDS], axis=0)
        gained_m_s2 = gained_m_s / ((len(speeds) - _ENDS) * self._cycle_s)
        more_Nm = self._differences_Nm / self._collected + inertia_kg_m2 * self._per_m * gained_m_s2
        ratios = np.array([line.radius_ratio(axis) for axis in range(1, len(more_Nm) + 1)])
        more_N = more_Nm * self._per_m / ratios
        promises_N = (self._promised_N / self._collected).tolist()
        for axis, usual_N, promised_N in zip(self._spans, self._usual_N, promises_N, strict=True):
            if axis in self._seen:
                is_N = promised_N - float(np.sum(more_N[axis:]))
                self._take(axis, is_N / promised_N if promised_N > _LEAST * usual_N else 1.0)

    def _take(self, axis: int, share: float) -> None:
        """What is left of a section's tension, in a block."""
        if self._time_s < _SETTLED_S:
            return
        low = share < (_WHOLE if self._torn[axis] else _TORN)
        self._torn[axis] = low and (self._low[axis] or self._torn[axis])
        self._low[axis] = low
        self._doubt_s[axis] = self._doubt_s[axis] + BLOCK_S if share < _DOUBTFUL else 0.0
