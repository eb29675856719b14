"""A line on the measured motion of its driven rollers, beside copies of it in which one unknown each is a little other.

What the copies do differently, over what was varied, is how everything depends on the unknowns: tensions, carriages.
An unknown is corrected by moving the line along those differences, as if it had been right from the start.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import pi
from typing import Final

import numpy as np

from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans
from hilbench.plant.web_line.stations import Idler, Reel, reel_name

#: Less of what a carriage was varied by is left no more, and is not blown up again.
_LEAST_LEFT: Final = 0.05


#: Of the web, by which idlers and carriages that swing against it come to rest.
_DAMPING_S: Final = 1e-3


class Kind(StrEnum):
    """What may be unknown of a line."""

    CARRIAGE = "carriage"  #: where it stands, m
    RADIUS = "radius"  #: of a reel: error over the radius at the start
    MODULUS = "modulus"  #: E of a section: relative error
    STRAIN = "strain"  #: of a section, times relative E: its tension, whatever E is


#: By how much each is varied: so little that nothing bends, so much that rounding does not show.
_STEPS: Final = {Kind.CARRIAGE: 1e-4, Kind.RADIUS: 1e-5, Kind.MODULUS: 1e-3, Kind.STRAIN: 1e-7}


@dataclass(frozen=True, slots=True)
class Unknown:
    """What is unknown, and where: number of the carriage, of the axis of a reel, or of the axis before a section."""

    kind: Kind
    number: int

    @property
    def step(self) -> float:
        """By which it is varied."""
        return _STEPS[self.kind]


def unknowns_of(model: ModelParameters, measured: Collection[str] = ()) -> tuple[Unknown, ...]:
    """Of a line: its carriages and reels; the strain of the sections without a carriage, which would make its own
    tension at once; E of each section where every reel is `measured` (stations by name): the tension beside one whose
    radius is not known shows that, and E no more."""
    before = axes_before_spans(model)
    held = {before[carriage.first_span - 1] for carriage in model.carriages}
    sections = range(1, model.axis_count)
    reels = [roller for roller in model.line_rollers if isinstance(roller.station, Reel)]
    known = all(reel_name(reel.station) in measured for reel in reels if isinstance(reel.station, Reel))
    return (
        *(Unknown(Kind.CARRIAGE, number) for number in range(1, len(model.carriages) + 1)),
        *(Unknown(Kind.RADIUS, roller.axis) for roller in reels if roller.axis is not None),
        *(Unknown(Kind.MODULUS, axis) for axis in sections if known),
        *(Unknown(Kind.STRAIN, axis) for axis in sections if axis not in held),
    )


class VariedLine:
    """The line, and a copy for each of `unknowns`; `measured`: as `unknowns_of`. Positions
    (N,) of the driven rollers are at the web."""

    def __init__(self, model: ModelParameters, measured: Collection[str] = ()) -> None:
        self.unknowns = unknowns_of(model, measured)
        self.line = damped_follower(model)
        self._model = model
        self._copies = [damped_follower(model) for _ in self.unknowns]
        self._rows = [row for row, roller in enumerate(model.line_rollers) if roller.axis is not None]
        self._idlers = [roller.name for roller in model.line_rollers if roller.axis is None]
        self._idler_rows = [row for row, each in enumerate(model.line_rollers) if isinstance(each.station, Idler)]
        self._rollers = len(model.line_rollers)
        before = axes_before_spans(model)
        self._spans = {axis: [k for k, of in enumerate(before) if of == axis] for axis in range(model.axis_count + 1)}
        self._slopes = {each.number: _slope_per_m(model, each.number) for each in self._of(Kind.RADIUS)}
        self._moduli = np.array([model.youngs_modulus_Pa(span) for span in range(1, model.span_count + 1)])
        self._pulls = self._lever_arms()
        self._errors = np.zeros(len(self.unknowns))  # of E and radii, as corrected so far

    def _of(self, kind: Kind) -> list[Unknown]:
        return [each for each in self.unknowns if each.kind is kind]

    def _lever_arms(self) -> Vector:
        """Load at each motor (N,) by the tensions (K,), N·m/N, with the reels as at the start."""
        arms = np.zeros((len(self._rows), self._model.span_count))
        for axis, row in enumerate(self._rows, 1):
            if self._model.carries_web_load(axis):
                per_N = 1.0 / self._model.motor_rad_per_m(axis)
                if row < arms.shape[1]:
                    arms[axis - 1, row] = per_N
                if row:
                    arms[axis - 1, row - 1] = -per_N
        return arms

    def reset(self, positions_m: Sequence[float], speed_m_s: float) -> None:
        """Start again at these positions, as the model is, with nothing corrected; rollers turn with the web, which has
        this speed."""
        turning = {f"v_{name}_m_s": speed_m_s for name in self._idlers}
        self._errors[:] = 0.0
        for unknown, follower in zip((None, *self.unknowns), (self.line, *self._copies), strict=True):
            self._put_moduli(follower, unknown)
            follower.reset([x + more for x, more in zip(positions_m, self._offsets_m(unknown), strict=True)])
            driven = {f"v{axis}_m_s": speed_m_s / follower.radius_ratio(axis) for axis in range(1, len(self._rows) + 1)}
            follower.set_state(turning | driven)
            if unknown is not None and unknown.kind is Kind.CARRIAGE:
                name = f"x_{self._model.carriages[unknown.number - 1].station.name}_m"
                at_m = self.carriage_m(unknown.number)
                follower.set_state({name: at_m + unknown.step})
            elif unknown is not None and unknown.kind is Kind.STRAIN:
                strain = self.line.strain
                follower.set_state({f"strain{k + 1}": strain[k] + unknown.step for k in self._spans[unknown.number]})

    def set_boundary(self, strain_prev: float, F_next_N: float) -> None:
        """What the neighbouring sections do from now on."""
        for follower in (self.line, *self._copies):
            follower.set_boundary(strain_prev, F_next_N)

    def set_input(self, name: str, value: float) -> None:
        """One of the inputs of a line from now on. Raises ValueError for an unknown name."""
        for follower in (self.line, *self._copies):
            follower.set_input(name, value)

    def follow(self, positions_m: Sequence[float], duration_s: float) -> None:
        """The driven rollers are now there, `duration_s` after the last call."""
        for unknown, follower in zip((None, *self.unknowns), (self.line, *self._copies), strict=True):
            offsets_m = self._offsets_m(unknown)
            follower.follow([x + more for x, more in zip(positions_m, offsets_m, strict=True)], duration_s)

    def _offsets_m(self, unknown: Unknown | None) -> list[float]:
        """How much further the rollers are taken to be: a reel of another radius has turned on by what it takes."""
        offsets = [0.0] * len(self._rows)
        for each, error in zip(self.unknowns, self._errors, strict=True):
            if each.kind is Kind.RADIUS:
                error += each.step if each is unknown else 0.0
                offsets[each.number - 1] = error / self._slopes[each.number]
        return offsets

    def _put_moduli(self, follower: LineFollower, unknown: Unknown | None) -> None:
        for each, error in zip(self.unknowns, self._errors, strict=True):
            if each.kind is Kind.MODULUS:
                error += each.step if each is unknown else 0.0
                for k in self._spans[each.number]:
                    follower.set_parameter(_modulus_name(k + 1, len(self._moduli)), self._moduli[k] * (1.0 + error))

    # -- what follows ------------------------------------------------------------------------------------

    def carriage_m(self, number: int) -> float:
        """Position of a carriage, from 1."""
        return float(self.line.motion[self._rollers + number - 1])

    def ratio(self, axis: int) -> float:
        """Radius of a reel over that at the start."""
        return self.line.radius_ratio(axis)

    def slope_per_m(self, axis: int) -> float:
        """Change of a reel's radius over that at the start, per m of its motion."""
        return self._slopes[axis]

    def modulus_factor(self, axis: int) -> float:
        """What E of the section behind an axis is multiplied with."""
        known = [e for each, e in zip(self.unknowns, self._errors, strict=True) if each == Unknown(Kind.MODULUS, axis)]
        return 1.0 + (known[0] if known else 0.0)

    def loads_Nm(self) -> Vector:
        """What the web pulls at each motor (N,), forward; reels with their present radius."""
        return self._ratios() * (self._pulls @ self.line.tension_N)

    def loads_without_turn_Nm(self) -> Vector:
        """The same with reels of the radius that the model has at their measured position."""
        loads: Vector = self._pulls @ self.line.tension_N
        for each, error in zip(self.unknowns, self._errors, strict=True):
            if each.kind is Kind.RADIUS:
                loads[each.number - 1] *= self.ratio(each.number) - error
        return loads

    def _ratios(self) -> Vector:
        ratios = np.ones(len(self._rows))
        for axis in self._slopes:
            ratios[axis - 1] = self.ratio(axis)
        return ratios

    def load_slopes(self) -> Vector:
        """How the loads (N,) change with each unknown, (N, n)."""
        own, ratios = self.line.tension_N, self._ratios()
        slopes = np.zeros((len(self._rows), len(self.unknowns)))
        for i, (unknown, copy) in enumerate(zip(self.unknowns, self._copies, strict=True)):
            slopes[:, i] = ratios * (self._pulls @ (copy.tension_N - own)) / unknown.step
            if unknown.kind is Kind.RADIUS:
                slopes[unknown.number - 1, i] += self._pulls[unknown.number - 1] @ own
        return slopes

    def carriage_slopes(self, number: int) -> Vector:
        """How the position of a carriage (from 1) depends on each unknown (n,)."""
        row, own = self._rollers + number - 1, self.carriage_m(number)
        return np.array(
            [(copy.motion[row] - own) / unknown.step for unknown, copy in zip(self.unknowns, self._copies, strict=True)]
        )

    def length_m(self, axis: int) -> float:
        """Of the section behind an axis, with what its carriages have made longer."""
        first = 4 * (self._rollers + len(self._model.carriages)) + len(self._moduli)
        return float(sum(self.line.motion[first + k] for k in self._spans[axis]))

    def strain(self, axis: int) -> float:
        """Of the section behind an axis, times relative E."""
        return self._seen(Unknown(Kind.STRAIN, axis), self.line)

    def cell_N(self, idler: int) -> float:
        """What the load cell of an idler (from 1) tells: the mean of the tensions on both sides."""
        return self._beside(self.line, idler)

    def cell_slopes(self, idler: int) -> Vector:
        """How that depends on each unknown (n,)."""
        own = self.cell_N(idler)
        return np.array(
            [
                (self._beside(copy, idler) - own) / unknown.step
                for unknown, copy in zip(self.unknowns, self._copies, strict=True)
            ]
        )

    def _beside(self, follower: LineFollower, idler: int) -> float:
        row = self._idler_rows[idler - 1]
        return 0.5 * float(follower.tension_N[row - 1] + follower.tension_N[row])

    # -- corrections -------------------------------------------------------------------------------------

    def correct(self, changes: Vector) -> None:
        """Go on as if the unknowns (n,) had been so much larger from the start."""
        differences = [copy.motion - self.line.motion for copy in self._copies]
        strains = {c: self._slopes_seen(each) for c, each in enumerate(self.unknowns) if each.kind is Kind.STRAIN}
        wanted = {c: self._seen(self.unknowns[c], self.line) + slopes @ changes for c, slopes in strains.items()}
        for i, unknown in enumerate(self.unknowns):
            if unknown.kind in (Kind.RADIUS, Kind.MODULUS):
                self._errors[i] += changes[i]
            self.line.motion = self.line.motion + changes[i] / unknown.step * differences[i]
        # Of another E the differences are no more those that they were: the tensions are to be right all the same.
        self._put_moduli(self.line, None)
        for c, slopes in strains.items():
            left = wanted[c] - self._seen(self.unknowns[c], self.line)
            if slopes[c] > _LEAST_LEFT:
                self.line.motion = self.line.motion + left / (slopes[c] * self.unknowns[c].step) * differences[c]
        for copy, difference in zip(self._copies, differences, strict=True):
            copy.motion = self.line.motion + difference
        for varied, follower in zip((None, *self.unknowns), (self.line, *self._copies), strict=True):
            self._put_moduli(follower, varied)
            follower.set_state(self._within_stops(follower))

    def rebook(self, changes: Vector) -> None:
        """E of sections is other by so much (n,), and has been all the time; their tensions are as they are."""
        before = self._errors.copy()
        for i, unknown in enumerate(self.unknowns):
            if unknown.kind is Kind.MODULUS:
                self._errors[i] += changes[i]
        first, count = 4 * (self._rollers + len(self._model.carriages)), len(self._moduli)
        for varied, follower in zip((None, *self.unknowns), (self.line, *self._copies), strict=True):
            motion = follower.motion.copy()
            for i, unknown in enumerate(self.unknowns):
                if unknown.kind is not Kind.MODULUS or not changes[i]:
                    continue
                step = unknown.step if unknown is varied else 0.0
                ratio = (1.0 + before[i] + step) / (1.0 + self._errors[i] + step)
                material = first + np.array(self._spans[unknown.number])
                length_m = motion[material + count]
                motion[material] = length_m / (1.0 + ratio * (length_m / motion[material] - 1.0))
            follower.motion = motion
            self._put_moduli(follower, varied)
            follower.set_state({})

    def _within_stops(self, follower: LineFollower) -> dict[str, float]:
        """Carriages that are beyond a stop, back at it."""
        back: dict[str, float] = {}
        for row, carriage in enumerate(self._model.carriages, self._rollers):
            station, at_m = carriage.station, float(follower.motion[row])
            lowest_m = -np.inf if station.lower_stop_m is None else station.lower_stop_m
            highest_m = np.inf if station.upper_stop_m is None else station.upper_stop_m
            if not lowest_m <= at_m <= highest_m:
                back |= {f"x_{station.name}_m": min(max(at_m, lowest_m), highest_m), f"v_{station.name}_m_s": 0.0}
        return back

    def renew(self) -> Vector:
        """Let carriages and strains be unknowns of now, and no more of the start: what other unknowns have made of them
        is their own from now on.

        Returns what the unknowns are in those of before, (n, n): new = matrix @ old.
        """
        turned = np.eye(len(self.unknowns))
        for c, unknown in enumerate(self.unknowns):
            if unknown.kind not in (Kind.CARRIAGE, Kind.STRAIN):
                continue
            slopes = self._slopes_seen(unknown)
            if not slopes[c] > _LEAST_LEFT:  # a slack web, or a carriage at its stop
                continue
            own = (self._copies[c].motion - self.line.motion) / (slopes[c] * unknown.step)
            for i, (each, copy) in enumerate(zip(self.unknowns, self._copies, strict=True)):
                if i == c:
                    copy.motion = self.line.motion + own * unknown.step
                else:
                    copy.motion = copy.motion - slopes[i] * each.step * own
                copy.set_state({})
            step = np.eye(len(self.unknowns))
            step[c] = slopes
            turned = step @ turned
        return turned

    def web_changed(self) -> Vector:
        """What unknowns become of others, (n, n), where web suddenly has another E with the strain that it has: its
        tension is another one at once."""
        turned = np.eye(len(self.unknowns))
        for c, unknown in enumerate(self.unknowns):
            modulus = Unknown(Kind.MODULUS, unknown.number)
            if unknown.kind is Kind.STRAIN and modulus in self.unknowns:
                strain = self._seen(unknown, self.line) / self.modulus_factor(unknown.number)
                slopes, i = self._slopes_seen(unknown), self.unknowns.index(modulus)
                # Of the strain that has come since the last `renew` the modulus makes another tension by itself.
                turned[c, i] = (strain - slopes[i]) / slopes[c] if slopes[c] > _LEAST_LEFT else 0.0
        return turned

    def _slopes_seen(self, unknown: Unknown) -> Vector:
        """How a carriage or strain depends on each unknown (n,)."""
        seen = self._seen(unknown, self.line)
        return np.array(
            [
                (self._seen(unknown, copy) - seen) / each.step
                for each, copy in zip(self.unknowns, self._copies, strict=True)
            ]
        )

    def _seen(self, unknown: Unknown, follower: LineFollower) -> float:
        """Position of a carriage, or strain times relative E of a section, which is its tension. The strain is that of
        how much web there is, which never swings."""
        if unknown.kind is Kind.CARRIAGE:
            return follower.motion.item(self._rollers + unknown.number - 1)
        spans, count = self._spans[unknown.number], len(self._moduli)
        first, motion = 4 * (self._rollers + len(self._model.carriages)), follower.motion
        material_m = sum(motion.item(first + k) for k in spans)
        length_m = sum(motion.item(first + count + k) for k in spans)
        factor: float = follower.parameter(_modulus_name(spans[0] + 1, count)) / self._moduli.item(spans[0])
        return factor * (length_m / material_m - 1.0)


def damped_follower(model: ModelParameters) -> LineFollower:
    """A line whose swings come to rest: those of the real one are not known, and what swings tells nothing slow."""
    follower = LineFollower(model)
    for span in range(1, model.span_count + 1):
        if not any(entry.effect == "web_damping" and entry.span in (None, span) for entry in model.effects):
            follower.set_effect("web_damping", section=span, time_constant_s=_DAMPING_S)
    return follower


def _slope_per_m(model: ModelParameters, axis: int) -> float:
    """Change of a reel's radius over that at the start, per m of its motion."""
    span, winds = (1, -1.0) if axis == 1 else (model.span_count, 1.0)
    return winds * per_item(model.required_web.thickness_m, span) / (2.0 * pi * model.radius_m(axis) ** 2)


def _modulus_name(span: int, spans: int) -> str:
    return f"span{span}.youngs_modulus_Pa" if spans > 1 else "youngs_modulus_Pa"
