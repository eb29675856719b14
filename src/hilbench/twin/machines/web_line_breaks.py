"""Web break, slip and slack detection in a section of a line with idlers, dancers, accumulators or reels.

All driven rollers after a section together carry the difference of its tension and that at the end of the line,
whatever is between them. So the residuals of their torques and speeds to the simulated line give the section's true
tension: where almost nothing is left of it, in two blocks running, the web is broken. Where the roller after it slips,
more and more is missing of the encoders' tension (`hilbench.estimation.web_line.section_slip`); a carriage would move
and keep the tension: with a sensor, lost web shows (`hilbench.estimation.web_line.carriage_slip`). Next to a reel
without a sensor the encoders' tension is unknown. If the encoders indicate slack and the torques tension, a roller next
to it does not move with its web.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Final

import numpy as np

from hilbench.estimation.plausibility import SLACK
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line.anomalies import BROKEN, LEAST_SHARE, WHOLE
from hilbench.estimation.web_line.block_means import BLOCK_S, ENDS
from hilbench.estimation.web_line.carriage_slip import CarriageSlip
from hilbench.estimation.web_line.section_slip import SectionSlip
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans
from hilbench.plant.web_line.sensitivity_model import Kind, SensitivityModel, Unknown
from hilbench.plant.web_line.stations import Reel, reel_name

#: Share of the tension below which nothing is learned, and for how long: a breaking web passes it, another web stays.
_DOUBTFUL, _DOUBT_S = 0.5, 0.15
#: Share of the usual tension by the torques from which on a web is tight; largest difference to the encoders' tension
#: that agrees; and travel, in section lengths, after which they agree again.
_PULLS, _AGREES, _AGREES_AGAIN = 0.25, 0.1, 1.0
#: Relative error of the web length carried by a reel with a sensor.
_REEL_SHARE: Final = 5e-4
#: Share of the usual tension that may accelerate the rollers in the slip detection: the model's accuracy.
_ACCELERATES: Final = 0.2
#: Settling time of the simulated line's tensions.
_SETTLED_S: Final = 0.5


class SectionWatch:
    """Detector of web breaks, slip and slack of a line whose N driven rollers answer once a cycle.

    `span_of`: span number of each section in reports, by the axis before it; `unknowns`: corrections of the simulated
    line; `measured`: names of stations with a sensor; `sensed_length_m`: length of the section after an axis, with its
    carriage at its sensed position.
    """

    def __init__(
        self,
        model: ModelParameters,
        cycle_s: float,
        span_of: Mapping[int, int],
        unknowns: Sequence[Unknown],
        measured: Sequence[str],
        sensed_length_m: Callable[[int], float],
    ) -> None:
        before = axes_before_spans(model)
        self._sensed_length_m = sensed_length_m
        self._model, self._cycle_s = model, cycle_s
        self._cycles = max(round(BLOCK_S / cycle_s), 2 * ENDS)
        self._spans = {axis: [k for k, of in enumerate(before) if of == axis] for axis in span_of}
        self._axes = axes = range(1, model.axis_count + 1)
        carried = [model.carries_web_load(axis) for axis in axes]
        #: Sections after which every roller is loaded: the tension of others is not observable by torques.
        self._seen = [axis for axis in span_of if all(carried[axis:])]
        self._span_of = span_of
        self._per_m = np.array([model.motor_rad_per_m(axis) for axis in axes])
        self._length_m = {axis: sum(model.span_length_m(k + 1) for k in spans) for axis, spans in self._spans.items()}
        self._usual_N = [model.upstream_strain * model.stiffness_N(spans[-1] + 1) for spans in self._spans.values()]
        self._slips = {
            axis: SectionSlip(usual_N, self._length_m[axis])
            for axis, usual_N in zip(self._spans, self._usual_N, strict=True)
            if axis in self._seen and {Unknown(Kind.STRAIN, axis), Unknown(Kind.MODULUS, axis)} <= set(unknowns)
        }
        self._carriage_slips = _carriage_slips(model, measured, self._length_m)
        self.reset(in_motion=False)

    def reset(self, *, in_motion: bool) -> None:
        """Reset for a released web, at rest or running."""
        self._time_s = 0.0
        self._low = dict.fromkeys(self._seen, False)  # in the previous block
        self._torn = dict.fromkeys(self._seen, False)
        self._doubt_s = dict.fromkeys(self._seen, 0.0)
        self._slack = dict.fromkeys(self._span_of, False)
        #: Latest time at which the encoders' tension agreed, where it does not; and the tension by the torques.
        self._belied_since_s: dict[int, float] = {}
        self._belied = dict.fromkeys(self._seen, False)  # in the previous block
        self._agreed_s = dict.fromkeys(self._seen, 0.0)
        self._agreed_m = dict.fromkeys(self._seen, 0.0)  # travel of the web since they agree again
        self._is_N: dict[int, float] = {}
        for slip in self._slips.values():
            slip.reset(in_motion=in_motion)
        for of_carriage in self._carriage_slips.values():
            of_carriage.reset()
        self._lengths_m: dict[int, float] = {}  # of the sections with a carriage, at the last evaluation
        self._judged_m: Vector | None = None  # positions of the driven rollers then
        self.interrupt()

    def suspend(self) -> None:
        """Stop the evaluation over unusable torques."""
        for slip in self._slips.values():
            slip.suspend()
        self.interrupt()

    def interrupt(self) -> None:
        """Start a new block after a missing cycle."""
        self._collected = 0
        self._differences_Nm = np.zeros(len(self._per_m))
        self._promised_N = [0.0] * len(self._spans)
        self._followed_N = dict.fromkeys(self._slips, 0.0)
        self._tightest_N = [0.0] * len(self._spans)
        self._travel_m: list[Vector] = []

    @property
    def problems(self) -> dict[int, Problem | None]:
        """Problem of each section, by its span number."""
        found: dict[int, Problem | None] = {}
        for axis, span in self._span_of.items():
            found[span] = Problem.SLACK if self._slack[axis] else None
            if self._torn.get(axis, False):
                found[span] = Problem.WEB_BREAK
            elif axis in self._belied_since_s or (not self._slack[axis] and self._is_slipping(axis)):
                found[span] = Problem.SLIP
        return found

    def _is_slipping(self, axis: int) -> bool:
        of_carriage = self._carriage_slips.get(axis)
        return (axis in self._slips and self._slips[axis].slips) or (
            of_carriage is not None and of_carriage.since_s < inf
        )

    @property
    def doubtful(self) -> bool:
        """True if a break is suspected: the torques are not to be learned from."""
        return any(self._torn.values()) or any(0.0 < doubt_s <= _DOUBT_S for doubt_s in self._doubt_s.values())

    @property
    def slips_since_s(self) -> float:
        """Latest time without slip; inf without slip."""
        since_s = [slip.since_s for slip in self._slips.values() if slip.slips]
        since_s += [slip.since_s for slip in self._carriage_slips.values()]
        return min([*since_s, *self._belied_since_s.values()], default=inf)

    def take_belied(self) -> dict[int, float]:
        """Tensions by torques, since the last call, of sections whose encoders' tension is wrong for good, N, by the
        axis before."""
        taken = {axis: tension_N for axis, tension_N in self._is_N.items() if axis in self._belied_since_s}
        self._is_N.clear()
        return taken

    def look(
        self,
        time_s: float,
        positions_m: Sequence[float],
        torques_Nm: Sequence[float],
        followed: SensitivityModel,
        inertia_kg_m2: Vector,
        *,
        swings: bool,
    ) -> None:
        """Evaluate a cycle: positions (N,) of the driven rollers at the web and torques, with the line that follows
        them; `inertia_kg_m2` (N,): at the motors; `swings`: carriages move after a change of the web."""
        line, tensions_N = followed.line, followed.tensions_N
        self._time_s += self._cycle_s
        self._now_N = self._by_model_N(followed)
        for axis, now_N in self._now_N.items():
            self._followed_N[axis] += now_N
        of_spans_N = tensions_N.tolist()
        for at, spans in enumerate(self._spans.values()):
            self._promised_N[at] += of_spans_N[spans[-1]]
            self._tightest_N[at] = max(self._tightest_N[at], min(of_spans_N[spans[0] : spans[-1] + 1]))
        self._travel_m.append(np.array(positions_m))
        self._differences_Nm -= np.asarray(torques_Nm) + line.load_torques_Nm(self._axes, line.v_m_s.tolist(), 0.0)
        self._collected += 1
        if self._collected > self._cycles:
            self._judge(time_s, line, inertia_kg_m2)
            self._look_for_lost_web(time_s, followed, swings)
            self._judged_m = self._travel_m[-1]
            self.interrupt()

    def corrected(self, followed: SensitivityModel) -> None:
        """Account for a correction of the simulated line since the last evaluation."""
        for axis, after_N in self._by_model_N(followed).items():
            self._slips[axis].correct(after_N - self._now_N[axis])

    def _by_model_N(self, followed: SensitivityModel) -> dict[int, float]:
        """Tension of the sections with slip detection, by the axis before, with the model's E."""
        tensions_N = followed.tensions_N
        return {axis: tensions_N.item(self._spans[axis][-1]) / followed.modulus_factor(axis) for axis in self._slips}

    def _judge(self, time_s: float, line: LineFollower, inertia_kg_m2: Vector) -> None:
        """Evaluate a complete block."""
        lows = zip(self._spans, self._tightest_N, self._usual_N, strict=True)
        self._slack = {axis: tightest_N <= SLACK * usual_N for axis, tightest_N, usual_N in lows}
        speeds = np.diff(np.array(self._travel_m), axis=0) / self._cycle_s
        gained_m_s = _middle(speeds[-ENDS:]) - _middle(speeds[:ENDS])
        gained_m_s2 = gained_m_s / ((len(speeds) - ENDS) * self._cycle_s)
        ratios = np.array([line.radius_ratio(axis) for axis in range(1, len(gained_m_s2) + 1)])
        accelerates_N = inertia_kg_m2 * self._per_m * gained_m_s2 * self._per_m / ratios
        more_N = self._differences_Nm / self._collected * self._per_m / ratios + accelerates_N
        promises_N = [total_N / self._collected for total_N in self._promised_N]
        for axis, usual_N, promised_N in zip(self._spans, self._usual_N, promises_N, strict=True):
            if axis in self._seen:
                is_N = promised_N - float(np.sum(more_N[axis:]))
                self._compare(time_s, axis, is_N / usual_N, promised_N / usual_N)
                self._is_N[axis] = is_N
                self._take(axis, is_N / promised_N if promised_N > LEAST_SHARE * usual_N else 1.0)
                steady = abs(np.sum(accelerates_N[axis:])) < _ACCELERATES * usual_N
                self._look_for_slip(time_s, axis, is_N, ratios.item(axis), steady=bool(steady))

    def _look_for_lost_web(self, time_s: float, followed: SensitivityModel, swings: bool) -> None:
        """Evaluate lost web in a complete block, for sections whose carriage has a sensor."""
        before_m, self._lengths_m = (
            self._lengths_m,
            {axis: self._sensed_length_m(axis) for axis in self._carriage_slips},
        )
        if self._judged_m is None or self._time_s < _SETTLED_S:
            return
        travels_m = self._travel_m[-1] - self._judged_m
        for axis, slip in self._carriage_slips.items():
            if swings:
                slip.allow()
            into_m, out_m = (float(travels_m[of - 1]) * followed.line.radius_ratio(of) for of in (axis, axis + 1))
            slip.take(time_s, into_m, out_m, self._lengths_m[axis] - before_m.get(axis, self._lengths_m[axis]))

    def _look_for_slip(self, time_s: float, axis: int, is_N: float, ratio: float, *, steady: bool) -> None:
        """Update slip detection by a block; `ratio`: radius of the roller after the section over that at the start."""
        if axis not in self._slips or self._judged_m is None or self._time_s < _SETTLED_S:
            return
        travel_m = float(self._travel_m[-1][axis] - self._judged_m[axis]) * ratio
        followed_N, lasted_s = self._followed_N[axis] / self._collected, self._collected * self._cycle_s
        self._slips[axis].take(time_s, is_N, followed_N, travel_m, lasted_s, steady=steady)

    def _compare(self, time_s: float, axis: int, share: float, promised: float) -> None:
        """Compare a section's tension by torques and by encoders in a block, both over the usual tension."""
        belied = self._slack[axis] and share > _PULLS
        self._slack[axis] &= not belied
        if belied and self._belied[axis] and self._time_s >= _SETTLED_S:
            self._belied_since_s.setdefault(axis, self._agreed_s[axis])
        self._belied[axis] = belied
        agrees = abs(share - promised) < _AGREES
        if agrees and axis not in self._belied_since_s:
            self._agreed_s[axis] = time_s - self._collected * self._cycle_s
        travel_m = 0.0 if self._judged_m is None else abs(float(self._travel_m[-1][axis] - self._judged_m[axis]))
        self._agreed_m[axis] = self._agreed_m[axis] + travel_m if agrees else 0.0
        if self._agreed_m[axis] > _AGREES_AGAIN * self._length_m[axis]:
            self._belied_since_s.pop(axis, None)

    def _take(self, axis: int, share: float) -> None:
        """Update break detection by the remaining share of a section's tension in a block."""
        if self._time_s < _SETTLED_S:
            return
        low = share < (WHOLE if self._torn[axis] else BROKEN)
        self._torn[axis] = low and (self._low[axis] or self._torn[axis])
        self._low[axis] = low
        self._doubt_s[axis] = self._doubt_s[axis] + BLOCK_S if share < _DOUBTFUL else 0.0


def _middle(values: Vector) -> Vector:
    """Median of an odd number of rows (n, N)."""
    found: Vector = np.sort(values, axis=0)[len(values) // 2]
    return found


def _carriage_slips(
    model: ModelParameters, measured: Sequence[str], lengths_m: Mapping[int, float]
) -> dict[int, CarriageSlip]:
    """Slip detectors of the sections with one carriage that has a sensor, by the axis before; not next to a reel
    without radius sensor. `lengths_m`: of the sections."""
    before = axes_before_spans(model)
    held = [before[carriage.first_span - 1] for carriage in model.carriages]
    reels = {each.axis: reel_name(each.station) for each in model.line_rollers if isinstance(each.station, Reel)}
    found = {}
    for axis, carriage in zip(held, model.carriages, strict=True):
        beside = [reels[of] for of in (axis, axis + 1) if of in reels]
        if held.count(axis) == 1 and {carriage.station.name, *beside} <= set(measured):
            strain = abs(model.upstream_strain) + (_REEL_SHARE if beside else 0.0)
            strands = carriage.last_span - carriage.first_span + 1
            found[axis] = CarriageSlip(lengths_m[axis], strands, strain)
    return found
