"""Web break, slip and slack detection in a section of a line with idlers, dancers, accumulators or reels.

All driven rollers after a section together carry the difference of its tension and that at the end of the line,
whatever is between them. So the residuals of their torques and speeds to the simulated line give the section's true
tension: where almost nothing is left of it the web is broken, and where the roller after it slips, more and more is
missing of the encoders' tension (`hilbench.estimation.web_line.section_anomalies`); a carriage would move and keep the
tension: with a sensor, lost web shows (`hilbench.estimation.web_line.carriage_slip`). Next to a reel without a sensor
the encoders' tension is unknown. If the encoders indicate slack and the torques tension, a roller next to it does not
move with its web.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Any, Final

import numpy as np

from hilbench.compiled import Vector
from hilbench.estimation.plausibility import SLACK
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line.anomalies import LEAST_SHARE
from hilbench.estimation.web_line.block_means import BLOCK_S, ENDS
from hilbench.estimation.web_line.carriage_slip import CarriageSlip
from hilbench.estimation.web_line.section_anomalies import SectionDetector
from hilbench.plant.web_line.line_cycle import LOAD
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_carriages, section_length_m, section_spans
from hilbench.plant.web_line.sensitivity_model import Kind, SensitivityModel, Unknown
from hilbench.plant.web_line.stations import Reel, reel_name
from hilbench.twin.machines.web_line_stations_cycle import WATCH, WatchArrays

#: Share of the tension below which nothing is learned, and for how long: a breaking web passes it, another web stays.
_DOUBTFUL, _DOUBT_S = 0.5, 0.15
#: Share of the usual tension by the torques from which on a web is tight; largest difference to the encoders' tension
#: that agrees; and travel, in section lengths, after which they agree again.
_PULLS, _AGREES, _AGREES_AGAIN = 0.25, 0.1, 1.0
#: Relative error of the web length carried by a reel with a sensor.
_REEL_SHARE: Final = 5e-4
#: Share of the usual tension that may accelerate the rollers in the slip detection: the model's accuracy.
_ACCELERATES: Final = 0.2
#: Settling time of the simulated line's tensions, and of a carriage that oscillates.
_SETTLED_S: Final = 0.5
#: Travel of a block of the slip detection, in section lengths: that of 20 ms on a span of 1 m at 3 m/s.
_BLOCK_SHARE: Final = 0.06


class _Section:
    """Section after an axis: its tests; `block`: of the compiled cycle."""

    def __init__(
        self, model: ModelParameters, axis: int, followed: SensitivityModel, measured: Sequence[str], block: WatchArrays
    ) -> None:
        self.axis, self._followed, self._block = axis, followed, block
        self._spans, self.length_m = section_spans(model, axis), section_length_m(model, axis)
        self.usual_N = model.upstream_strain * model.stiffness_N(self._spans[-1] + 1)
        #: Every roller after it is loaded: the tension of others is not observable by torques.
        self.seen = all(model.carries_web_load(later) for later in range(axis + 1, model.axis_count + 1))
        corrected = {Unknown(Kind.STRAIN, axis), Unknown(Kind.MODULUS, axis)} <= followed.places.keys()
        self._breaks = SectionDetector(self.usual_N, self.length_m, 0.0)
        block_m = _BLOCK_SHARE * self.length_m
        self.slip = SectionDetector(self.usual_N, self.length_m, block_m) if self.seen and corrected else None
        self.of_carriage = _carriage_slip(model, measured, axis, self.length_m)

    def reset(self, *, in_motion: bool) -> None:
        """Reset for a released web, at rest or running."""
        self.slack, self._doubt_s = False, 0.0
        self.belied_since_s = inf  #: latest time at which the encoders' tension agreed, where it does not
        self._belied = False  # in the previous block
        self._apart_s = self._agrees_s = 0.0  # for how long they have not agreed but for moments, and have agreed
        self._agreed_s = self._agreed_m = 0.0  # travel of the web since they agree again
        self.is_N: float | None = None  #: tension by the torques of the last block
        self.carried_m: float | None = None  #: length with a carriage, at the last evaluation
        self._breaks.reset(in_motion=False)
        if self.slip is not None:
            self.slip.reset(in_motion=in_motion)
        if self.of_carriage is not None:
            self.of_carriage.reset()

    def suspend(self) -> None:
        """Stop the evaluation over unusable torques."""
        self._breaks.suspend()
        if self.slip is not None:
            self.slip.suspend()

    def corrected(self) -> None:
        """Account for a correction of the simulated line since the last cycle."""
        if self.slip is not None:
            last, now = int(self._block.state["last"][0]), self._followed
            self.slip.correct(self._by_model_N(now.tensions_N, now.errors) - self._by_model_N(*self._seen(last)))

    def _seen(self, at: int | slice) -> tuple[Vector, Vector]:
        return self._block.tensions_N[at], self._block.errors[at]

    def _by_model_N(self, tensions_N: Vector, errors: Vector) -> Any:
        """Tension with the model's E, by tensions of the spans (…, K) and errors of the unknowns (…, n)."""
        at = self._followed.places[Unknown(Kind.MODULUS, self.axis)]
        return tensions_N[..., self._spans[-1]] / (1.0 + errors[..., at])

    def look_for_slack(self) -> None:
        """Look whether the web was slack in the whole block."""
        tightest_N = self._block.tensions_N[:, self._spans].min(axis=1).max()
        self.slack = bool(max(tightest_N, 0.0) <= SLACK * self.usual_N)

    @property
    def changes(self) -> bool:
        """True if E may just have changed: torques and encoders disagree since lately, and not for good."""
        return 0.0 < self._apart_s < _SETTLED_S

    @property
    def problem(self) -> Problem | None:
        """Problem of the web."""
        if self._breaks.found is Problem.WEB_BREAK:
            return Problem.WEB_BREAK
        if self.belied_since_s < inf or (not self.slack and self.slips_since_s < inf):
            return Problem.SLIP
        return Problem.SLACK if self.slack else None

    @property
    def slips_since_s(self) -> float:
        """Latest time without slip or belied encoders; inf without them."""
        slips = self.slip is not None and self.slip.found is Problem.SLIP
        since_s = self.slip.since_s if self.slip is not None and slips else inf
        return min(since_s, self.belied_since_s, inf if self.of_carriage is None else self.of_carriage.since_s)

    @property
    def doubtful(self) -> bool:
        """True if a break is suspected."""
        return self._breaks.found is Problem.WEB_BREAK or 0.0 < self._doubt_s <= _DOUBT_S

    def judge(
        self, time_s: float, lasted_s: float, cycles: int, more_N: Vector, accelerates_N: Vector, travel_m: float | None
    ) -> None:
        """Evaluate a block of so many cycles: what is more by the torques of the rollers (N,), and accelerates them;
        travel of the web since the last one, None if there is none or the simulated line has not settled."""
        promised_N = sum(self._block.tensions_N[:, self._spans[-1]].tolist()) / cycles
        is_N = promised_N - float(np.sum(more_N[self.axis :]))
        self._compare(time_s - lasted_s, lasted_s, is_N / self.usual_N, promised_N / self.usual_N, travel_m)
        self.is_N = is_N
        if travel_m is None:
            return
        share = is_N / promised_N if promised_N > LEAST_SHARE * self.usual_N else 1.0
        self._doubt_s = self._doubt_s + BLOCK_S if share < _DOUBTFUL else 0.0
        self._breaks.take(time_s, is_N, promised_N, travel_m, lasted_s, steady=True)
        if self.slip is not None:
            steady = bool(abs(np.sum(accelerates_N[self.axis :])) < _ACCELERATES * self.usual_N)
            followed_N = sum(self._by_model_N(*self._seen(slice(None))).tolist()) / cycles
            self.slip.take(time_s, is_N, followed_N, travel_m, lasted_s, steady=steady)

    def _compare(self, began_s: float, lasted_s: float, share: float, promised: float, travel_m: float | None) -> None:
        """Compare the tension by torques and by encoders in a block, both over the usual tension."""
        belied = self.slack and share > _PULLS
        self.slack &= not belied
        if belied and self._belied and travel_m is not None:
            self.belied_since_s = min(self.belied_since_s, self._agreed_s)
        self._belied = belied
        agrees = abs(share - promised) < _AGREES
        if agrees and self.belied_since_s == inf:
            self._agreed_s = began_s
        self._agreed_m = self._agreed_m + abs(travel_m or 0.0) if agrees else 0.0
        self._agrees_s = self._agrees_s + lasted_s if agrees else 0.0
        apart = not agrees or (self._apart_s > 0.0 and self._agrees_s < _SETTLED_S)
        self._apart_s = self._apart_s + lasted_s if apart else 0.0
        if self._agreed_m > _AGREES_AGAIN * self.length_m:
            self.belied_since_s = inf


class SectionWatch:
    """Detector of web breaks, slip and slack of a line whose N driven rollers answer once a cycle.

    `span_of`: span number of each section in reports, by the axis before it; `followed`: the line that follows them;
    `measured`: names of stations with a sensor; `sensed_length_m`: length of the section after an axis, with its
    carriage at its sensed position. The compiled cycle collects a block in `arrays`.
    """

    def __init__(
        self,
        model: ModelParameters,
        cycle_s: float,
        span_of: Mapping[int, int],
        followed: SensitivityModel,
        measured: Sequence[str],
        sensed_length_m: Callable[[int], float],
    ) -> None:
        self._sensed_length_m, self._cycle_s, self._span_of = sensed_length_m, cycle_s, span_of
        cycles = max(round(BLOCK_S / cycle_s), 2 * ENDS)
        axes = range(1, model.axis_count + 1)
        self._per_m, self._followed = np.array([model.motor_rad_per_m(axis) for axis in axes]), followed
        loads = [(axis - 1, model.motor_rad_per_m(axis), model.carries_web_load(axis)) for axis in axes]
        sizes = len(axes), len(axes), model.span_count, len(followed.unknowns)
        rows = (np.zeros((cycles + 1, size)) for size in sizes)
        self.arrays = WatchArrays(np.zeros(1, WATCH), np.array(loads, LOAD), *rows)
        self._sections = [_Section(model, axis, followed, measured, self.arrays) for axis in span_of]
        self.reset(in_motion=False)

    def reset(self, *, in_motion: bool) -> None:
        """Reset for a released web, at rest or running."""
        self.arrays.state["time_s"] = self.arrays.state["suspended"] = 0.0
        for section in self._sections:
            section.reset(in_motion=in_motion)
        self._judged_m: Vector | None = None  # positions of the driven rollers at the last evaluation
        self.interrupt()

    def suspend(self) -> None:
        """Stop the evaluation over unusable torques."""
        for section in self._sections:
            section.suspend()
        self.interrupt()
        self.arrays.state["suspended"] = 1.0

    def interrupt(self) -> None:
        """Start a new block after a missing cycle, and show the compiled cycle what is known."""
        state, slips_since_s = self.arrays.state[0], self.slips_since_s
        state["count"] = 0.0
        state["doubtful"], state["since_s"] = self.doubtful, slips_since_s
        state["problem"] = any(section.problem is not None for section in self._sections)
        state["belied"] = any(each.is_N is not None and each.belied_since_s < inf for each in self._sections)

    @property
    def problems(self) -> dict[int, Problem | None]:
        """Problem of each section, by its span number."""
        return {self._span_of[section.axis]: section.problem for section in self._sections}

    @property
    def doubtful(self) -> bool:
        """True if a break is suspected: the torques are not to be learned from."""
        return any(section.doubtful for section in self._sections)

    @property
    def slips_since_s(self) -> float:
        """Latest time without slip; inf without slip."""
        return min([section.slips_since_s for section in self._sections], default=inf)

    def take_belied(self) -> dict[int, float]:
        """Tensions by torques, since the last call, of sections whose encoders' tension is wrong for good, N, by the
        axis before."""
        taken = {}
        for section in self._sections:
            if section.is_N is not None and section.belied_since_s < inf:
                taken[section.axis] = section.is_N
            section.is_N = None
        self.arrays.state["belied"] = 0.0
        return taken

    def corrected(self) -> None:
        """Account for a correction of the simulated line since the last evaluation."""
        for section in self._sections:
            section.corrected()

    def judge(self, time_s: float, inertia_kg_m2: Vector, *, swings: bool) -> None:
        """Evaluate a complete block; `inertia_kg_m2` (N,): at the motors; `swings`: carriages move after a change of
        the web."""
        positions_m, travels_m = self.arrays.positions_m, None
        count, ratios = len(positions_m), self._followed.ratios
        speeds = np.diff(positions_m, axis=0) / self._cycle_s
        gained_m_s = _middle(speeds[-ENDS:]) - _middle(speeds[:ENDS])
        gained_m_s2 = gained_m_s / ((len(speeds) - ENDS) * self._cycle_s)
        accelerates_N = inertia_kg_m2 * self._per_m * gained_m_s2 * self._per_m / ratios
        more_N = -sum(self.arrays.torques_Nm) / count * self._per_m / ratios + accelerates_N
        if self._judged_m is not None and self.arrays.state["time_s"][0] >= _SETTLED_S:
            travels_m = (positions_m[-1] - self._judged_m) * ratios
        for section in self._sections:
            section.look_for_slack()
            if section.seen:
                travel_m = None if travels_m is None else travels_m.item(section.axis)
                section.judge(time_s, count * self._cycle_s, count, more_N, accelerates_N, travel_m)
            if section.of_carriage is not None:
                before_m, section.carried_m = section.carried_m, self._sensed_length_m(section.axis)
                if travels_m is not None:
                    into_m, out_m = travels_m[section.axis - 1 : section.axis + 1].tolist()
                    room_m = 0.0 if before_m is None else section.carried_m - before_m
                    section.of_carriage.take(time_s, into_m, out_m, room_m, allowed=swings or section.changes)
        self._judged_m = positions_m[-1].copy()
        self.interrupt()


def _middle(values: Vector) -> Vector:
    """Median of an odd number of rows (n, N)."""
    found: Vector = np.sort(values, axis=0)[len(values) // 2]
    return found


def _carriage_slip(model: ModelParameters, measured: Sequence[str], axis: int, length_m: float) -> CarriageSlip | None:
    """Slip detector of the section after an axis, of this length, if it has one carriage that has a sensor, and is not
    next to a reel without radius sensor."""
    held = [each for each, of in zip(model.carriages, axes_before_carriages(model), strict=True) if of == axis]
    reels = {each.axis: reel_name(each.station) for each in model.line_rollers if isinstance(each.station, Reel)}
    beside = [reels[of] for of in (axis, axis + 1) if of in reels]
    if len(held) != 1 or not {held[0].station.name, *beside} <= set(measured):
        return None
    strain = abs(model.upstream_strain) + (_REEL_SHARE if beside else 0.0)
    return CarriageSlip(length_m, held[0].last_span - held[0].first_span + 1, strain)
