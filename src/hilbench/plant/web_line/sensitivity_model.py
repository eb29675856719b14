"""Sensitivity model: a line on the measured motion of its driven rollers, and copies with one unknown perturbed each.

The copies' differences over the perturbation are the sensitivities of tensions and carriages to the unknowns. An
unknown is corrected by moving the line along those differences, as if it had been right from the start.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import StrEnum
from math import pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, Reals, Reals2, Vector, Wholes2, arrays_in, entry_point, table_of
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.line_follower import LineFollower, PerturbedCopies
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_carriages, axes_before_spans, section_spans
from hilbench.plant.web_line.stations import Reel, reel_name

#: Least remaining share of a carriage's perturbation; less is not rescaled.
_LEAST_LEFT: Final = 0.05


#: Damping of the web, by which idlers and carriages that oscillate against it come to rest.
_DAMPING_S: Final = 1e-3


class SlopesArrays(NamedTuple):
    """Sensitivities of the load at each motor (N, n + 1), by tensions (F, K), radii over those at the start (N,), load
    per tension (N, K), perturbations and errors (n,), observability of unknowns by tensions (n, K), axis and unknown of
    each reel, from 0."""

    tensions: Reals2
    ratios: Reals
    pulls: Reals2
    steps: Reals
    errors: Reals
    identifies: Reals2
    reels: Wholes2
    slopes: Reals2


@entry_point(COUNT, TABLE, allocates=False)
def put_load_slopes(unused: int, table: NDArray[np.int64]) -> int:
    """Update the load sensitivities; see `SlopesArrays`."""
    tensions, ratios, pulls, steps, errors, identifies, reels, slopes = arrays_in(table, SlopesArrays)
    for i in range(pulls.shape[0]):
        for c in range(len(steps)):
            pull = 0.0
            for j in range(pulls.shape[1]):
                pull += pulls[i, j] * identifies[c, j] * (tensions[1 + c, j] - tensions[0, j])
            slopes[i, c] = ratios[i] * pull / steps[c]
        slopes[i, len(steps)] = 0.0
    for r in range(reels.shape[0]):
        i, c, own = reels[r, 0], reels[r, 1], 0.0
        for j in range(pulls.shape[1]):
            own += pulls[i, j] * tensions[0, j]
        slopes[i, c] += own
        slopes[i, len(steps)] = own * errors[c]
    return 0


class Kind(StrEnum):
    """Kind of an unknown of a line."""

    CARRIAGE = "carriage"  #: its position, m
    RADIUS = "radius"  #: of a reel: error over the radius at the start
    MODULUS = "modulus"  #: E of a section: relative error
    STRAIN = "strain"  #: of a section, times relative E: its tension, independent of E


#: Perturbation of each: small enough to be linear, large enough against rounding.
_STEPS: Final = {Kind.CARRIAGE: 1e-4, Kind.RADIUS: 1e-5, Kind.MODULUS: 1e-3, Kind.STRAIN: 1e-7}


class Unknown(NamedTuple):
    """Unknown with its location: number of the carriage, of a reel's axis, or of the axis before a section."""

    kind: Kind
    number: int

    @property
    def step(self) -> float:
        """Size of its perturbation."""
        return _STEPS[self.kind]


def estimated_parameters_of(model: ModelParameters, measured: Collection[str] = ()) -> tuple[Unknown, ...]:
    """Unknowns of a line: its carriages and reels; the strain of the sections without a carriage, which would set its
    own tension at once; E of each section where every reel is `measured` (stations by name): next to an unknown radius
    the tension identifies that, and not E."""
    held = axes_before_carriages(model)
    sections = range(1, model.axis_count)
    reels = [roller for roller in model.line_rollers if isinstance(roller.station, Reel)]
    known = all(reel_name(reel.station) in measured for reel in reels if isinstance(reel.station, Reel))
    return (
        *(Unknown(Kind.CARRIAGE, number) for number in range(1, len(model.carriages) + 1)),
        *(Unknown(Kind.RADIUS, roller.axis) for roller in reels if roller.axis is not None),
        *(Unknown(Kind.MODULUS, axis) for axis in sections if known),
        *(Unknown(Kind.STRAIN, axis) for axis in sections if axis not in held),
    )


class SensitivityModel:
    """Line and a perturbed copy for each of `unknowns`; `measured`: as `estimated_parameters_of`. Positions (N,) of the
    driven rollers are at the web."""

    def __init__(self, model: ModelParameters, measured: Collection[str] = ()) -> None:
        self.unknowns = estimated_parameters_of(model, measured)
        self.places = {unknown: place for place, unknown in enumerate(self.unknowns)}
        self._place_of_modulus = {each.number: at for each, at in self.places.items() if each.kind is Kind.MODULUS}
        self.line = damped_follower(model)
        self._model = model
        self._followers = [self.line, *(damped_follower(model) for _ in self.unknowns)]
        self._moduli_of_each = [follower.moduli_Pa for follower in self._followers]
        #: All of them, the line itself in the first row.
        self.copies = PerturbedCopies(self._followers)
        #: Tensions of the spans (K,) as of the last call; radii of the driven rollers (N,) over those at the start.
        self.tensions_N, self.ratios = self.copies.tensions_N[0], self.copies.ratios
        self.steps = np.array([unknown.step for unknown in self.unknowns])
        self._axes = model.axis_count
        self._idlers = [roller.name for roller in model.line_rollers if roller.axis is None]
        self._rollers, carriages = len(model.line_rollers), model.carriages
        self._before, self._span_count = axes_before_spans(model), model.span_count
        self._held = axes_before_carriages(model)
        #: Offsets of material lengths and span lengths in the integrated quantities.
        self._material = 4 * (self._rollers + len(carriages))
        self._lengths = self._material + self._span_count
        idle = [row for row, each in enumerate(model.line_rollers) if each.axis is None]
        turning = 2 * (self._rollers + len(carriages))
        #: Indices of idler angles in the integrated quantities: nothing depends on them or restores them.
        self._turned = np.array([*idle, *(turning + row for row in idle)], int)
        #: Quantities that a strain changes only through carriages: carriage positions, and lengths of spans.
        moved = range(self._rollers, self._rollers + len(carriages))
        spans = range(self._lengths, self._lengths + model.span_count)
        self._kept_by_strain = np.array([*moved, *(turning + row for row in moved), *spans], int)
        self._stops = [
            (self._rollers + at, each.station.name, each.station.lower_stop_m, each.station.upper_stop_m)
            for at, each in enumerate(carriages)
        ]
        self._spans = {axis: section_spans(model, axis) for axis in range(model.axis_count + 1)}
        #: Change of each reel's radius over that at the start, per m of its motion, by its axis.
        self.slopes_per_m = {each.number: _slope_per_m(model, each.number) for each in self._of(Kind.RADIUS)}
        self._moduli = np.array([model.youngs_modulus_Pa(span) for span in range(1, model.span_count + 1)])
        self._pulls = self._lever_arms()
        self.errors = np.zeros(len(self.unknowns))  #: of E and radii, as corrected so far
        #: Sensitivities of the web load at each motor, forward, N·m, to each unknown, and in the last column its excess
        #: over that with reels of the model's radius at their measured position (N, n + 1).
        self.load_slopes = np.zeros((self._axes, len(self.unknowns) + 1))
        radii = [(each.number - 1, place) for each, place in self.places.items() if each.kind is Kind.RADIUS]
        reels = np.array(radii, np.int64).reshape(-1, 2)
        lines, identifies = self.copies, self._identified_moduli()
        of_slopes = lines.ratios, self._pulls, self.steps, self.errors, identifies, reels, self.load_slopes
        self._kept = SlopesArrays(lines.tensions_N, *of_slopes)
        self.slopes_table = table_of(self._kept)  #: of `put_load_slopes`

    def _of(self, kind: Kind) -> list[Unknown]:
        return [each for each in self.unknowns if each.kind is kind]

    def _identified_moduli(self) -> Vector:
        """Observability of unknowns by tensions (n, K): where a carriage keeps them E of its web shows only in
        oscillations, whose initial state is unknown."""
        identifies = np.ones((len(self.unknowns), self._span_count))
        for axis in self._held:
            if axis in self._place_of_modulus:
                identifies[self._place_of_modulus[axis], self._spans[axis]] = 0.0
        return identifies

    def _lever_arms(self) -> Vector:
        """Load at each motor (N,) by the tensions (K,), N·m/N, with the reels as at the start."""
        rows = [row for row, roller in enumerate(self._model.line_rollers) if roller.axis is not None]
        arms = np.zeros((len(rows), self._span_count))
        for axis, row in enumerate(rows, 1):
            if self._model.carries_web_load(axis):
                per_N = 1.0 / self._model.motor_rad_per_m(axis)
                if row < arms.shape[1]:
                    arms[axis - 1, row] = per_N
                if row:
                    arms[axis - 1, row - 1] = -per_N
        return arms

    def reset(self, positions_m: Sequence[float], speed_m_s: float) -> None:
        """Restart at these positions with the model's state, uncorrected; rollers turn with the web at this speed."""
        turning = {f"v_{name}_m_s": speed_m_s for name in self._idlers}
        self.errors[:] = 0.0
        self._put_errors()
        for unknown, follower, offsets_m in zip(
            (None, *self.unknowns), self._followers, self.copies.offsets_m, strict=True
        ):
            follower.reset(np.asarray(positions_m) + offsets_m)
            driven = {f"v{axis}_m_s": speed_m_s / follower.radius_ratio(axis) for axis in range(1, self._axes + 1)}
            follower.set_state(turning | driven)
            if unknown is not None and unknown.kind is Kind.CARRIAGE:
                name = self._stops[unknown.number - 1][1]
                at_m = self.line.motion.item(self._rollers + unknown.number - 1)
                follower.set_state({f"x_{name}_m": at_m + unknown.step})
            elif unknown is not None and unknown.kind is Kind.STRAIN:
                strain = self.line.strain
                follower.set_state({f"strain{k + 1}": strain[k] + unknown.step for k in self._spans[unknown.number]})
        self.copies.show()

    def _put_errors(self) -> None:
        """Apply corrected and perturbed E and radii to line and copies: a reel of another radius has turned on
        accordingly."""
        moduli_Pa = np.tile(self._moduli, (len(self._followers), 1))
        for i, unknown in enumerate(self.unknowns):
            if unknown.kind is Kind.RADIUS:
                per_m = self.slopes_per_m[unknown.number]
                self.copies.offsets_m[:, unknown.number - 1] = self._error_of_each(i) / per_m
            elif unknown.kind is Kind.MODULUS:
                moduli_Pa[:, self._spans[unknown.number]] *= 1.0 + self._error_of_each(i)[:, None]
        for view, own_Pa in zip(self._moduli_of_each, moduli_Pa, strict=True):
            view[:] = own_Pa

    def _error_of_each(self, place: int) -> Vector:
        """Error of an unknown in the line and the copies (F,), relative to the model."""
        errors = np.full(1 + len(self.unknowns), self.errors[place])
        errors[1 + place] += self.steps[place]
        return errors

    # -- values ------------------------------------------------------------------------------------------

    def carriage_row(self, number: int) -> int:
        """Index of a carriage's position in the integrated quantities."""
        return self._rollers + number - 1

    def position_m(self, carriage: int) -> float:
        """Position of a carriage, from 1."""
        return float(self.copies.motions[0, self.carriage_row(carriage)])

    def modulus_factor(self, axis: int) -> float:
        """Factor on E of the section after an axis."""
        place = self._place_of_modulus.get(axis)
        return 1.0 + (0.0 if place is None else self.errors.item(place))

    def refresh_load_slopes(self) -> None:
        """Update `load_slopes` to the present state."""
        put_load_slopes(0, self.slopes_table)

    def _over_steps(self, seen: Vector) -> Vector:
        """Sensitivity of an output of line and copies (F,) to each unknown (n,)."""
        slopes: Vector = (seen[1:] - seen[0]) / self.steps
        return slopes

    def length_m(self, axis: int) -> float:
        """Length of the section after an axis, including its carriages' strands."""
        return float(sum(self.copies.motions[0, self._lengths + k] for k in self._spans[axis]))

    def longer_by(self, carriage: Unknown, axis: int) -> float:
        """Increase of the length of the section after an axis per travel of its carriage; 0 at a stop."""
        c = self.places[carriage]
        further = self._slopes_seen(carriage).item(c)
        return self._over_steps(self._web_m(axis)[0]).item(c) / further if further > _LEAST_LEFT else 0.0

    def strain(self, axis: int) -> float:
        """Strain of the section after an axis, times relative E."""
        return self._seen(Unknown(Kind.STRAIN, axis)).item(0)

    # -- corrections -------------------------------------------------------------------------------------

    def correct(self, changes: Vector) -> None:
        """Correct the unknowns by `changes` (n,), as if they had been right from the start."""
        motions = self.copies.motions
        differences = motions[1:] - motions[0]
        seen = {c: self._seen(each) for c, each in enumerate(self.unknowns) if each.kind is Kind.STRAIN}
        strains = {c: self._over_steps(of_each) for c, of_each in seen.items()}
        wanted = {c: seen[c][0] + slopes @ changes for c, slopes in strains.items()}
        for i, unknown in enumerate(self.unknowns):
            if unknown.kind in (Kind.RADIUS, Kind.MODULUS):
                self.errors[i] += changes[i]
        motions[0] += (changes / self.steps) @ differences
        # With another E the differences change: the tensions have to be right all the same.
        for c, slopes in strains.items():
            left = wanted[c] - self._seen(self.unknowns[c])[0]
            if slopes[c] > _LEAST_LEFT:
                motions[0] += left / (slopes[c] * self.steps[c]) * differences[c]
        motions[1:] = motions[0] + differences
        self._put_errors()
        self.copies.put()
        self._keep_within_stops()

    def rebook(self, changes: Vector) -> None:
        """Correct E of sections by so much (n,), as if from the start, at constant tensions."""
        before = [self._error_of_each(i) for i in range(len(self.unknowns))]
        for i, unknown in enumerate(self.unknowns):
            if unknown.kind is not Kind.MODULUS or not changes[i]:
                continue
            self.errors[i] += changes[i]
            ratio = (1.0 + before[i]) / (1.0 + self._error_of_each(i))
            for k in self._spans[unknown.number]:
                motions = self.copies.motions
                material, lengths = motions[:, self._material + k], motions[:, self._lengths + k]
                material[:] = lengths / (1.0 + ratio * (lengths / material - 1.0))
        self._put_errors()
        self.copies.put()

    def _keep_within_stops(self) -> None:
        """Move carriages beyond a stop back to it."""
        beyond = False
        for row, name, lower_m, upper_m in self._stops:
            lowest_m, highest_m = -np.inf if lower_m is None else lower_m, np.inf if upper_m is None else upper_m
            at_m = self.copies.motions[:, row]
            for line in np.flatnonzero((at_m < lowest_m) | (at_m > highest_m)).tolist():
                back_m, beyond = min(max(at_m.item(line), lowest_m), highest_m), True
                self._followers[line].set_state({f"x_{name}_m": back_m, f"v_{name}_m_s": 0.0})
        if beyond:
            self.copies.show()

    def renew(self) -> Vector:
        """Redefine carriages and strains as unknowns of now instead of the start, including the influence of other
        unknowns.

        Returns the change of basis of the unknowns, (n, n): new = matrix @ old.
        """
        turned, motions = np.eye(len(self.unknowns)), self.copies.motions
        motions[1:, self._turned] = motions[0, self._turned]
        for c, unknown in enumerate(self.unknowns):
            if unknown.kind not in (Kind.CARRIAGE, Kind.STRAIN):
                continue
            if unknown.kind is Kind.STRAIN:  # carriages come first: the rest is rounding, and would be magnified
                motions[1 + c, self._kept_by_strain] = motions[0, self._kept_by_strain]
            slopes = self._slopes_seen(unknown)
            if not slopes[c] > _LEAST_LEFT:  # a slack web, or a carriage at its stop
                continue
            own = (motions[1 + c] - motions[0]) / (slopes[c] * self.steps[c])
            motions[1:] -= np.outer(slopes * self.steps, own)
            motions[1 + c] = motions[0] + own * self.steps[c]
            step = np.eye(len(self.unknowns))
            step[c] = slopes
            turned = step @ turned
        self.copies.put()
        return turned

    def web_changed(self) -> Vector:
        """Change of unknowns (n, n) by a sudden change of E at constant strain: the tension jumps, and a carriage soon
        yields."""
        turned = np.eye(len(self.unknowns))
        for c, unknown in enumerate(self.unknowns):
            if unknown.kind is Kind.CARRIAGE:
                axis = self._held[unknown.number - 1]
                lengths_m, material_m = self._web_m(axis)
                longer = self.longer_by(unknown, axis)
                if axis in self._place_of_modulus and longer:
                    turned[c, self._place_of_modulus[axis]] = (material_m - lengths_m).item(0) / longer
            i = self._place_of_modulus.get(unknown.number)
            if unknown.kind is Kind.STRAIN and i is not None:
                seen = self._seen(unknown)
                strain, slopes = seen[0] / self.modulus_factor(unknown.number), self._over_steps(seen)
                # The strain's part since the last `renew` already changes the tension with E.
                turned[c, i] = (strain - slopes[i]) / slopes[c] if slopes[c] > _LEAST_LEFT else 0.0
        return turned

    def _slopes_seen(self, unknown: Unknown) -> Vector:
        """Sensitivity of a carriage or strain to each unknown (n,)."""
        return self._over_steps(self._seen(unknown))

    def _seen(self, unknown: Unknown) -> Vector:
        """Carriage position of line and copies (F,), or a section's strain times relative E, which is its tension. The
        strain is by the amount of web, which never oscillates."""
        if unknown.kind is Kind.CARRIAGE:
            return self.copies.motions[:, self.carriage_row(unknown.number)]
        length_m, material_m = self._web_m(unknown.number)
        place = self._place_of_modulus.get(unknown.number)
        factors = 1.0 if place is None else 1.0 + self._error_of_each(place)
        seen: Vector = factors * (length_m / material_m - 1.0)
        return seen

    def _web_m(self, axis: int) -> tuple[Vector, Vector]:
        """Length of the section after an axis, and unstretched length of its web, for line and copies (F,)."""
        motions, spans = self.copies.motions, self._spans[axis]
        first, count = spans[0], len(spans)
        length_m, material_m = (
            np.add.reduce(motions[:, at + first : at + first + count], axis=1) for at in (self._lengths, self._material)
        )
        return length_m, material_m


def damped_follower(model: ModelParameters) -> LineFollower:
    """Damped line follower: the real line's oscillations are unknown, and have no information on slow unknowns."""
    follower = LineFollower(model)
    for span in range(1, model.span_count + 1):
        if not any(entry.effect == "web_damping" and entry.span in (None, span) for entry in model.effects):
            follower.set_effect("web_damping", section=span, time_constant_s=_DAMPING_S)
    return follower


def _slope_per_m(model: ModelParameters, axis: int) -> float:
    """Change of a reel's radius over that at the start, per m of its motion."""
    span, winds = (1, -1.0) if axis == 1 else (model.span_count, 1.0)
    return winds * per_item(model.required_web.thickness_m, span) / (2.0 * pi * model.radius_m(axis) ** 2)
