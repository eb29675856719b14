"""Sizes of the effects that every stand has, with standard deviations, from the recording of a commissioning.

Friction, offset, inertia, ripple and eccentricity are fitted together, beside what looks like them (scale of the
torque, creep, E, a lasting error of the strain, unbalance, gains of the drive's loop), each with what is believed of it
before anything is measured: what the data can't tell apart stays as wide as that, and is said. The prediction is that
of a diagnosis: driven by the commands, or by filtered motion, so that no regressor has the noise of the torque. What
the fit leaves is the noise, by its spectrum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.fit import weights
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.noise import Whitening
from hilbench.diagnosis.predictor import choice
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_noise import Uncertainty, uncertainty
from hilbench.diagnosis.space import Space, noise_model
from hilbench.diagnosis.terms import Place, Term, strength_parts
from hilbench.diagnosis.web_line_machine import WIDE, believed_sizes
from hilbench.errors import UnusableInputError
from hilbench.estimation.web_line.config import ModelErrorsConfig
from hilbench.plant.effect import Section
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

#: What is measured of each axis, and what a person calls it.
MEASURED: Final = {
    "coulomb_friction": "dry friction",
    "viscous_friction": "viscous friction",
    "inertia_mismatch": "inertia, relative to the model's",
    "torque_offset": "torque offset",
    "torque_ripple": "torque ripple",
    "roller_eccentricity": "roller eccentricity",
    "torque_scale": "torque scale, relative",
    "web_slip": "creep",
}
#: What is fitted beside it.
_BESIDE: Final = ("elasticity_shift", "strain_offset", "unbalance")
#: The same of the drives' loops, each strength by itself, and what is believed of its relative error: half of what a
#: diagnosis takes for usual.
_OF_LOOPS: Final = "drive_gain"
_LOOP_SHARE: Final = 0.1
#: Gauss–Newton steps with the derivatives of the beginning, before one with those of where they end: strengths are
#: nearly linear.
_STEPS: Final = 3
#: Finite-difference steps, as a share of those of a search: a scale and an inertia that are tied must not be separated
#: by the curvature of their differences.
_FINE: Final = 0.01
#: Deviations from which a ripple of an order that was searched for is one: among a thousand orders and three axes
#: noise has one so large in a commissioning of a hundred.
_RIPPLE: Final = 5.0
#: Correlation of the errors of two from which they are tied with each other.
_TIED: Final = 0.9
#: How far from a whole number of times a turn an order is that one: a motor makes a hundred turns in a commissioning.
_WHOLE: Final = 0.02
_ORDER: Final = frozenset({"order"})


@dataclass(frozen=True)
class Commissioned:
    """One parameter of an effect, in its unit, with what the model has of it; its standard deviation, and the effects
    that it is tied with. `order`: of a ripple, per turn of the motor."""

    effect: str
    axis: int | None
    section: Section | None
    parameter: str
    value: float
    deviation: float
    unit: str
    tied_with: tuple[str, ...] = ()
    order: float | None = None


def commissioned(
    recording: Recording,
    model: Machine,
    place: str | Path,
    emulation: AnyEmulation | None,
    errors: ModelErrorsConfig,
    modulus_pct: float,
) -> list[Commissioned]:
    """Fit the recording of a commissioning.

    errors: what is believed of a web line before; modulus_pct: how well E of the web is known, standard deviation;
    place: of the recording, for errors. Raises UnusableInputError, one line, for a recording that can't be used: one in
    which nothing moves, too.
    """
    data = measured_from(recording, model, place)
    predictor = choice(model, data, emulation).predictor
    space, proposer = Space(model, predictor, data.period_s), Proposer(model, data)
    terms = [term for term in proposer.direct() if term.effect.id in (*MEASURED, *_BESIDE) and has_own(term, model)]
    loops = machines.effect_of(model, _OF_LOOPS)  # each gain by itself
    gains = [proposer.known(loops, axis, {}) for axis in range(1, model.axis_count + 1)]
    terms += [replace(gain, part=part) for gain in gains for part in loops.strength]
    # Once a turn of each motor: stated where no other order is prominent.
    waves = proposer.waves([1.0]).items()
    terms += [replace(wave, held=_ORDER) for where, (wave,) in waves if where.effect == "torque_ripple"]
    shares = {
        "torque_scale": 0.01 * errors.torque_scale_pct,
        "inertia_mismatch": 0.01 * errors.inertia_pct,
        _OF_LOOPS: _LOOP_SHARE,
    }

    def believed(term: Term) -> float:
        sizes = shares | believed_sizes(term, model, errors, 0.01 * modulus_pct)
        return sizes.get(term.effect.id, WIDE * term.size)

    found = _Fitted.of(space, terms, believed, place)
    if ripples := _searched_ripples(found, proposer, believed):
        found = _Fitted.of(space, [*found.terms, *ripples], believed, place)
    return found.stated()


def _searched_ripples(found: _Fitted, proposer: Proposer, believed: Callable[[Term], float]) -> list[Term]:
    """Ripples of the orders that are prominent in the torque residuals, of each whole number where it is one."""
    space = found.space
    left = np.where(space.predictor.rows, found.left, 0.0)
    named, every = dict(zip(space.predictor.names, left, strict=True)), space.predictor.every
    ripples = [one for one in proposer.searched(named, found.terms, every) if one.effect.id == "torque_ripple"]
    sure: dict[tuple[int | None, float], Term] = {}
    for term in ripples:
        whole = proposer.at_whole_orders(term)
        near = [each for each in whole if abs(each.values["order"] - term.values["order"]) < _WHOLE]
        one = near[0] if near else replace(term, held=_ORDER)
        slot = term.slot + sum(axis == term.axis for axis, _ in sure)
        place = (term.axis, one.values["order"])
        if slot < term.effect.slots and place not in sure:
            started, deviations = found.beside(replace(one, slot=slot), believed(one))
            if deviations > _RIPPLE:
                sure[place] = started
    return list(sure.values())


@dataclass(frozen=True)
class _Fitted:
    """Terms fitted to all rows that count and to what is believed of them; `coordinates` (J,) with their covariance,
    which bounds of the terms do not cut; whitened: derivatives by them (J, signals, n), and what is left (signals, n).
    """

    space: Space
    terms: list[Term]
    coordinates: Array
    covariance: Array
    white: Whitening
    columns: Array
    left: Array
    precision: Array

    @classmethod
    def of(cls, space: Space, terms: list[Term], believed: Callable[[Term], float], place: str | Path) -> _Fitted:
        """Gauss–Newton from where the terms are, with what is believed (standard deviation) around what the model has.

        Where a bound of a term cuts it, its coordinate is that of the last step, which none cuts: a friction that is
        not there is found on either side of zero.
        """
        sizes = [len(term.coordinates()) for term in terms]
        precision = np.repeat([believed(term) for term in terms], sizes) ** -2.0
        centre = np.concatenate([term.neutral().coordinates() for term in terms])
        rows, exact = space.predictor.rows, space.predictor.exact
        terms = [replace(term, size=_FINE * term.size) for term in terms]
        for steps in (_STEPS, 1):
            point = space.point(terms)
            white = noise_model(space, point.residual, point.derivatives) if exact else weights(space, terms)
            white = _with_positions_alike(white, space)
            columns, raw = white.apply(point.derivatives), point.residual
            flat = columns[..., rows].reshape(len(columns), -1)
            normal = flat @ flat.T + np.diag(precision)
            scale = np.sqrt(np.diag(normal))
            for _ in range(steps):
                if not np.isfinite(raw).all():
                    raise UnusableInputError(place, "the model runs away, expected the machine that it describes")
                residual, here = white.apply(raw), np.concatenate([term.coordinates() for term in terms])
                towards = flat @ residual[:, rows].reshape(-1) + precision * (centre - here)
                step = np.linalg.solve(normal / np.outer(scale, scale), towards / scale) / scale
                parts = np.split(here + step, np.cumsum(sizes)[:-1])
                terms = [term.at(part) for term, part in zip(terms, parts, strict=True)]
                raw = space.residual(terms) if steps > 1 else raw
        left = residual - np.tensordot(step, columns, 1)
        known = _uncertainty(space, columns, left, precision)
        terms = [replace(term, size=term.size / _FINE) for term in terms]
        return cls(space, terms, here + step, known.covariance, white, columns, left, precision)

    def beside(self, term: Term, believed: float) -> tuple[Term, float]:
        """Add a term of two components: its values given the others, and its amplitude in standard deviations."""
        rows = self.space.predictor.rows
        residual = self.space.residual(self.terms)
        (response,) = self.space.strengths(self.terms, residual, [term])
        columns = np.concatenate([self.columns, self.white.apply(response)])
        precision = np.concatenate([self.precision, np.full(len(response), believed**-2.0)])
        flat = columns[..., rows].reshape(len(columns), -1)
        scale = np.sqrt(np.diag(flat @ flat.T) + precision)
        normal = (flat @ flat.T + np.diag(precision)) / np.outer(scale, scale)
        found = np.linalg.solve(normal, flat @ self.left[:, rows].reshape(-1) / scale) / scale
        left, own = self.left - np.tensordot(found, columns, 1), slice(len(self.columns), None)
        covariance = _uncertainty(self.space, columns, left, precision).covariance[own, own]
        square = float(found[own] @ np.linalg.solve(covariance, found[own]))
        return term.at(found[own]), float(np.sqrt(square))

    def stated(self) -> list[Commissioned]:
        """Measured values, one for each parameter at each place; of several ripples of an axis the largest."""
        found: dict[Place, Commissioned] = {}
        for term in self.terms:
            if term.effect.id not in MEASURED:
                continue
            one = self._stated(term)
            if term.effect.id == "torque_ripple" and term.slot > 0 and one.value < _RIPPLE * one.deviation:
                continue  # it was searched for, and given all others it is none
            if term.place not in found or one.value > found[term.place].value:
                found[term.place] = one
        return list(found.values())

    def _stated(self, term: Term) -> Commissioned:
        """Strength and its deviation; of two components the amplitude, without what noise adds to its square."""
        part = self._part(term)
        found, covariance = self.coordinates[part], self.covariance[part, part]
        value, variance = float(found[0]), float(covariance[0, 0])
        if term.has_phase:
            square, noise = float(found @ found), float(np.trace(covariance))
            along = found / max(np.sqrt(square), 1e-300)
            value = float(np.sqrt(max(square - noise, 0.0)))
            variance = float(along @ covariance @ along) if square > noise else 0.5 * noise
        parameter = term.effect.parameter(term.effect.strength[0])
        what = (term.effect.id, term.axis, term.section, parameter.name, value, float(np.sqrt(variance)))
        return Commissioned(*what, parameter.unit, self._tied(term), term.values.get("order"))

    def _part(self, term: Term) -> slice:
        return strength_parts(self.terms)[self.terms.index(term)]

    def _tied(self, term: Term) -> tuple[str, ...]:
        at = self._part(term)
        deviations = np.sqrt(np.diag(self.covariance))
        correlation = np.abs(self.covariance / np.outer(deviations, deviations))
        others = [other for other in self.terms if other is not term]
        tied = [other for other in others if np.max(correlation[at, self._part(other)]) > _TIED]
        return tuple(dict.fromkeys(other.place.beside(term.place) for other in tied))


def _are_forces(space: Space) -> NDArray[np.bool_]:
    """(signals,): which are torques or tensions, and not where an axis is."""
    return np.array([name.startswith(("tau", "F")) for name in space.predictor.names])


def _with_positions_alike(white: Whitening, space: Space) -> Whitening:
    """`white` with position errors by their tolerance common to all rows: however many there are, they count as
    one. Else the rounding of a command, over a minute, would be an offset."""
    alike = np.where(_are_forces(space), 1.0, np.count_nonzero(space.predictor.rows) ** -0.5)
    return Whitening(white.filters * alike[:, None])


def _uncertainty(space: Space, columns: Array, left: Array, precision: Array) -> Uncertainty:
    """Uncertainty of coordinates, with the residual of torques and tensions as noise; whitened columns (J, signals,
    n)."""
    forces, rows = _are_forces(space), space.predictor.rows
    others = columns[:, ~forces][..., rows].reshape(len(columns), -1)
    known = np.diag(precision) + others @ others.T
    least = 1.0 if space.predictor.exact else 0.0  # whitened by the noise of each signal alone
    return uncertainty(columns[:, forces][..., rows], left[forces][:, rows], known, least)


#: Share up to which radii are one.
_SAME_RADIUS: Final = 0.01


def has_own(term: Term, model: Machine) -> bool:
    """True if the data have information on this term by itself.

    What is of all spans is stated of each. Rollers of one radius keep their angles to each other, so that the web shows
    how far each is out of true beyond the first: of that one nothing is stated then.
    """
    if term.effect.per_section and term.section is None and model.span_count > 1:
        return False
    if term.effect.id != "roller_eccentricity" or term.axis != 1 or not isinstance(model, ModelParameters):
        return True
    radii_m = [model.radius_m(axis) for axis in range(1, model.axis_count + 1)]
    return max(radii_m) > (1.0 + _SAME_RADIUS) * min(radii_m)
