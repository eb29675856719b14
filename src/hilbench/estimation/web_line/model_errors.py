"""What the twin's model may lack is estimated beside E, and E's deviation holds what can't be told apart from it.

Slowly, from means of the balance over blocks of some cycles (`model_errors_filter`), while the synchronizer follows E
in each cycle: it is given the force without what is known to be no tension. As long as the data do not say that
something is lacking nothing is taken out, and E is what the model makes of the torque. When more is known, the past
means another E (`rebased_N`).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import hypot, log, sqrt
from typing import NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    CUBE,
    MATRIX,
    REAL,
    TABLE,
    VECTOR,
    compiled,
    entry_point,
    inlined,
    noinline,
    number_of_sources,
)
from hilbench.estimation import noise_level, ring
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line import model_errors_filter as filters
from hilbench.estimation.web_line import ripples, swings
from hilbench.estimation.web_line.balance import BalanceSample, MeasuredBalance
from hilbench.estimation.web_line.config import ModelErrorsConfig
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S
from hilbench.plant.web_line.parameters import ModelParameters

#: A block: short against the span's transport and the drives' loops, long enough for motion to be differentiated.
_BLOCK_S = 0.02
#: Probability that a group of errors is there, before anything is measured.
_LACKING = 0.1
_LACKS_ANYTHING = 1.0 - (1.0 - _LACKING) ** len(filters.GROUPS)
#: Deviation of E at the start: anything that pulls alike is E until the data tell.
_INITIAL_E = 0.5
#: Time in which what the model lacks may wander through its prior: a working day.
_WANDER_S = 36000.0
#: The same of an eccentricity: the angles of two rollers part slowly.
_BEAT_S = 2000.0
#: Random walk of E, relative per sqrt(s): while speed or tension change, and while they don't: nothing can be told
#: then from a drift of E.
_E_WALK, _E_WALK_STEADY = 1e-3, 4e-3
#: Without measurements what is known is forgotten: the prior's variance is added in this time, s, up to so much of it.
_FORGOTTEN_S, _MOST_FORGOTTEN = 1.0, 1.5
#: Force that keeps a roller at rest over the friction of one that rolls: anything between both signs.
_STUCK = 0.6
#: Deviation of a force that comes and goes, relative to the tension: at least, and in deviations of how far the tension
#: that is told goes to and fro, over which time, on an average over which time. What goes much farther than usual
#: counts only so much (variances): that is a change of E.
_REST = 4e-3
_REST_SHARE, _APART_S, _USUAL_S, _MOST_APART = 1.0, 0.5, 5.0, 9.0
#: E that is told has jumped when it is another one than so many blocks before by so many deviations of how far it goes
#: to and fro, and by so much of itself.
_JUMP_BLOCKS, _JUMPS, _LEAST_JUMP = 5, 4.0, 0.02
#: Friction at another speed, beyond viscous: share of its prior deviation after a change by 1 m/s.
_CURVE = 0.05
#: Strain that is not as it is measured, as the web that comes in sways, is no tension: up to which share of it.
_MOST_SWAY = 0.05
#: A parameter counts as told apart when the data have shrunk its prior deviation to this share.
_SEPARABLE = 0.7
#: The deviation of what accelerates counts so many times: the blocks of a ramp err alike.
_ALIKE_IN_A_RAMP = 1.5
#: Relative difference of the radii up to which the rollers' angles are one.
_SAME_RADIUS = 0.01
_TORQUE_NOISE_NM, _TORQUE_FLOOR_NM = 0.05, 1e-4
_POSITION_NOISE_M, _POSITION_FLOOR_M = 2e-7, 2e-8
#: Names of what is found, by its place in the filters; what swings apart.
_NAMES = {
    "torque_offset_Nm": filters.OFFSET,
    "dry_friction_N": filters.DRY,
    "viscous_friction_N_s_per_m": filters.VISCOUS,
    "creep_per_N": filters.CREEP,
}


def prior_deviations(config: ModelErrorsConfig, model: ModelParameters, force_per_torque_per_m: float) -> Array:
    """Standard deviations of the filters' states (N,), from sizes of the machine; of E and REST: 0."""
    boundary = model.boundary
    tension_N = max(boundary.upstream_tension_N, boundary.downstream_tension_N)
    strain = tension_N / model.stiffness_N(1)
    if model.drives is not None:
        limit_Nm = per_item(model.drives.torque_limit_Nm, 2)
    else:
        limit_Nm = 5.0 * tension_N / force_per_torque_per_m
    friction_N = 0.01 * config.friction_pct * tension_N
    equal = abs(model.radius_m(1) / model.radius_m(2) - 1.0) < _SAME_RADIUS
    priors = np.zeros(filters.SIZE_OF_EQUALS if equal else filters.LARGEST)
    priors[filters.OFFSET] = hypot(
        0.01 * config.torque_offset_pct * limit_Nm * force_per_torque_per_m,
        0.01 * config.strain_pct * tension_N,
    )
    priors[filters.DRY] = friction_N
    priors[filters.STUCK] = _STUCK * friction_N
    priors[filters.VISCOUS] = friction_N / config.at_speed_m_s
    priors[filters.SCALE] = 0.01 * config.torque_scale_pct
    priors[filters.MASS] = 0.01 * config.inertia_pct
    priors[filters.UNBALANCE_COS] = priors[filters.UNBALANCE_SIN] = 0.01 * config.unbalance_pct * tension_N
    priors[filters.CREEP] = 0.01 * config.creep_pct * strain / tension_N
    for axis, cosine in ((2, filters.COS2),) if equal else ((2, filters.COS2), (1, filters.COS1)):
        radius_m = model.radius_m(axis)
        priors[cosine] = priors[cosine + 1] = 1e-6 * config.eccentricity_um / radius_m / sqrt(2.0)
    return priors


class ErrorVectors(NamedTuple):
    """What `ModelErrors` consist of, for compiled callers; K filters of N states."""

    u: Array  #: as all to `kept`: what `model_errors_filter.cycle` takes
    s: Array
    z: Array
    p: Array
    places: Places
    weights: Array
    process: Array
    work: Array
    theta: Array
    priors: Array
    orders: Array
    kept: Array
    torque: Array  #: state of the torque's `NoiseLevel`
    position: Array  #: the same of the position's
    k: Array  #: sizes, and how far E goes to and fro
    first_z: Array  #: as before the first measurement, like the next two
    first_p: Array
    first_weights: Array


# Of ErrorVectors.k; behind it a ring of the E that was told, a value a block.
(
    _REFERENCE_PA,
    _FORCE_PER_TORQUE,
    _RADIUS_1_M,
    _RADIUS_2_M,
    _PER_TORQUE2,  # variance of the force per variance of the torque
    _PER_POSITION2,  # the same per variance of the position
    _BLOCKS_S,
    _LEAST_REST_N2,
    _REST_N2,
    _TOLD_SIZE,  # of that ring
    _TOLD,
) = range(11)


@compiled
def interrupt(e: ErrorVectors) -> None:
    """A cycle is missing, or can't be used: no mean goes across."""
    e.s[filters.COUNT] = 0.0
    ring.clear(e.k, _TOLD)
    ripples.interrupt(e.kept)


@inlined
def likely_deviation_N(e: ErrorVectors) -> float:
    """What the correction may be wrong by (standard deviation), by what is likely: mostly the model lacks nothing.

    As far as more speaks for something that is lacking than before anything was measured: what that would be of a web
    that pulls no more, as a change of the tension shows.
    """
    lacking = e.s[filters.LACKING]
    shows = min(max(e.s[filters.APPLIED], (lacking - _LACKS_ANYTHING) / (1.0 - _LACKS_ANYTHING)), 1.0)
    return float(shows * e.s[filters.INTERCEPT_N] + (1.0 - shows) * e.s[filters.SPREAD_N] * sqrt(lacking))


@compiled
def take(
    e: ErrorVectors,
    x1_m: float,
    x2_m: float,
    torque_Nm: float,
    force_N: float,
    web_per_Pa: float,
    velocity_m_s: float,
    next_N: float,
    told_Pa: float,
) -> None:
    """Take the balance of this cycle; see `ModelErrors.update`."""
    u, k = e.u, e.k
    noise_level.take(e.torque, torque_Nm)
    noise_level.take(e.position, x2_m)
    u[filters.FORCE_N] = force_N
    u[filters.WEB_N] = web_per_Pa * k[_REFERENCE_PA]
    u[filters.SPEED_M_S] = velocity_m_s
    u[filters.TOLD] = told_Pa / k[_REFERENCE_PA]
    u[filters.RESISTANCE_N] = torque_Nm * k[_FORCE_PER_TORQUE] + next_N - force_N
    u[filters.NEXT_N] = next_N
    u[filters.ANGLE_1] = x1_m / k[_RADIUS_1_M]
    u[filters.ANGLE_2] = x2_m / k[_RADIUS_2_M]
    u[filters.MOTOR_ANGLE] = x2_m * k[_FORCE_PER_TORQUE]
    position_m2 = noise_level.variance(e.position)
    u[filters.POSITION_M2] = position_m2
    u[filters.VARIANCE_N2] = k[_PER_TORQUE2] * noise_level.variance(e.torque) + k[_PER_POSITION2] * position_m2
    if filters.cycle(u, e.s, e.z, e.p, e.places, e.weights, e.process, e.work, e.theta, e.priors, e.orders, e.kept):
        _look_at_unrest(e, told_Pa, web_per_Pa)
    if e.s[filters.RIPPLES_CHANGED] != 0.0:
        _forget(e)


@compiled
def _look_at_unrest(e: ErrorVectors, told_Pa: float, web_per_Pa: float) -> None:
    """How far E as it is told goes to and fro: what no error of a constant size explains comes and goes."""
    k = e.k
    ring.push(k, _TOLD, told_Pa)
    if not ring.is_full(k, _TOLD):
        return
    jumped_N = abs(told_Pa - ring.value(k, _TOLD, int(k[_TOLD_SIZE]) - _JUMP_BLOCKS)) * web_per_Pa
    steadily = filters.keeps_speed(e.u, e.s) or filters.keeps_acceleration(e.s)
    by_itself = 0.0 < e.s[filters.APPLIED] < 1.0 or not steadily
    jumps = not by_itself and jumped_N > max(_JUMPS * sqrt(k[_REST_N2]), _LEAST_JUMP * told_Pa * web_per_Pa)
    e.u[filters.TOLD_JUMPED] = 1.0 if jumps and e.s[filters.JUMPED_S] > _APART_S else 0.0
    apart_N = _REST_SHARE * (told_Pa - ring.value(k, _TOLD, 0)) * web_per_Pa
    more_N2 = min(apart_N * apart_N, _MOST_APART * k[_REST_N2]) - k[_REST_N2]
    k[_REST_N2] = max(k[_REST_N2] + k[_BLOCKS_S] / _USUAL_S * more_N2, k[_LEAST_REST_N2])
    e.u[filters.REST_N] = sqrt(k[_REST_N2])


@compiled
def _forget(e: ErrorVectors) -> None:
    """What has been learned with a ripple in the torque that was not known of is worth nothing; E stays."""
    noinline()
    filter_count, size = e.z.shape
    for k in range(filter_count):
        for i in range(size):
            if i != filters.E:
                e.z[k, i] = e.first_z[k, i]
            for j in range(size):
                e.p[k, i, j] = e.first_p[k, i, j]
        e.weights[k] = e.first_weights[k]
    for place in (filters.EXCESS, filters.LEANING, filters.SURPRISED, filters.COUNT):
        e.s[place] = 0.0


_INTERRUPT, _UPDATE = range(2)


def _compiled_entry(sources: int) -> Callable[..., None]:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point(
        COUNT,
        VECTOR,
        VECTOR,
        MATRIX,
        CUBE,
        TABLE,
        VECTOR,
        VECTOR,
        MATRIX,
        VECTOR,
        VECTOR,
        MATRIX,
        *[VECTOR] * 4,
        MATRIX,
        CUBE,
        VECTOR,
        *[REAL] * 8,
    )
    def act(
        what: int,
        u: Array,
        s: Array,
        z: Array,
        p: Array,
        places: Places,
        weights: Array,
        process: Array,
        work: Array,
        theta: Array,
        priors: Array,
        orders: Array,
        kept: Array,
        torque: Array,
        position: Array,
        k: Array,
        first_z: Array,
        first_p: Array,
        first_weights: Array,
        x1_m: float,
        x2_m: float,
        torque_Nm: float,
        force_N: float,
        web_per_Pa: float,
        velocity_m_s: float,
        next_N: float,
        told_Pa: float,
    ) -> None:
        if sources < 0:
            return
        filter_bank = (u, s, z, p, places, weights, process, work, theta, priors, orders, kept)
        e = ErrorVectors(*filter_bank, torque, position, k, first_z, first_p, first_weights)
        if what == _INTERRUPT:
            interrupt(e)
        else:
            take(e, x1_m, x2_m, torque_Nm, force_N, web_per_Pa, velocity_m_s, next_N, told_Pa)

    return act


_act = _compiled_entry(
    number_of_sources(
        noise_level.__file__, ring.__file__, ripples.__file__, swings.__file__, filters.__file__, __file__
    )
)


class ModelErrors:
    """Friction, offset, scale, mass, creep, unbalance and eccentricity beyond the model's, of the roller behind the
    first span."""

    def __init__(
        self,
        config: ModelErrorsConfig,
        model: ModelParameters,
        balance: MeasuredBalance,
        youngs_modulus_Pa: float,
        cycle_s: float,
    ) -> None:
        f = filters
        self._force_per_torque = balance.force_per_torque_per_m
        self._radius_m = model.radius_m(2)
        self._priors = prior_deviations(config, model, self._force_per_torque)
        tension_N = max(model.boundary.upstream_tension_N, model.boundary.downstream_tension_N)
        u = self._u = np.zeros(f.INPUTS)
        u[f.MASS_KG], u[f.SPAN_M] = balance.mass_kg, balance.span_length_m
        u[f.STIFFNESS_N] = youngs_modulus_Pa * balance.section_m2
        u[f.REST_N] = _REST * tension_N
        u[f.CURVE_N2] = (_CURVE * self._priors[f.DRY]) ** 2
        u[f.STANDSTILL_M_S] = 5.0 * FRICTION_WIDTH_M_S
        u[f.STUCK_N] = self._priors[f.STUCK]
        u[f.MOST_SWAY_N] = _MOST_SWAY * tension_N
        self._process = 2.0 / _WANDER_S * self._priors**2
        self._process[f.COS2 :] *= _WANDER_S / _BEAT_S
        self._process[f.E] = _E_WALK**2
        u[f.STEADY_E2] = _E_WALK_STEADY**2
        self._torque = NoiseLevel(_TORQUE_NOISE_NM, _TORQUE_FLOOR_NM)
        self._position = NoiseLevel(_POSITION_NOISE_M, _POSITION_FLOOR_M)
        self._s = np.zeros(f.KEPT)
        self._k = np.zeros(_TOLD)
        self._set_cycle(cycle_s)
        k = self._k
        k[_REFERENCE_PA], k[_FORCE_PER_TORQUE] = youngs_modulus_Pa, self._force_per_torque
        k[_RADIUS_1_M], k[_RADIUS_2_M] = model.radius_m(1), model.radius_m(2)
        k[_PER_TORQUE2] = self._force_per_torque**2
        k[_PER_POSITION2] = 2.0 * (u.item(f.STIFFNESS_N) / u.item(f.SPAN_M)) ** 2
        k[_LEAST_REST_N2] = k[_REST_N2] = u.item(f.REST_N) ** 2
        self._start()

    def _set_cycle(self, cycle_s: float) -> None:
        f, block = filters, max(2, round(_BLOCK_S / cycle_s))
        self._u[f.CYCLE_S], self._u[f.BLOCK] = cycle_s, block
        blocks = round(_APART_S / (block * cycle_s)) + 1
        k = np.zeros(_TOLD + ring.size(blocks))
        k[:_TOLD] = self._k[:_TOLD]
        ring.put(k, _TOLD, blocks)
        k[_TOLD_SIZE], k[_BLOCKS_S] = blocks, block * cycle_s
        self._k = k

    def _start(self) -> None:
        """A filter for every subset of the groups, the empty one first and that of all last."""
        f, size = filters, len(self._priors)
        subsets = sorted(product((False, True), repeat=len(f.GROUPS)), key=sum)
        self._z = np.zeros((len(subsets), size))
        self._p = np.zeros((len(subsets), size, size))
        self._places = np.full((len(subsets), size), -1, np.int64)
        self._weights = np.zeros(len(subsets))
        for k, chosen in enumerate(subsets):
            places = [f.E, f.REST, f.SWAY, f.QUICK]
            for there, group in zip(chosen, f.GROUPS, strict=True):
                places += [place for place in group if there and place < size]
                self._weights[k] += log(_LACKING if there else 1.0 - _LACKING)
            self._places[k, : len(places)] = places
            self._z[k, f.E] = 1.0
            for place in places:
                self._p[k, place, place] = self._priors[place] ** 2
            self._p[k, f.E, f.E] = _INITIAL_E**2
            self._p[k, f.REST, f.REST] = self._u[f.REST_N] ** 2
            self._p[k, f.SWAY, f.SWAY] = f.SWAY_SHARE**2
            self._p[k, f.QUICK, f.QUICK] = f.QUICK_SHARE**2
        self._first = self._z.copy(), self._p.copy(), self._weights.copy()
        self._theta = np.zeros(size)
        self._work = np.zeros((4, size + 1))
        self._orders, self._kept_of_orders = ripples.new_table()
        self._s[f.SPREAD_N] = hypot(self._priors[f.OFFSET], self._priors[f.DRY])

    @property
    def vectors(self) -> ErrorVectors:
        """What they consist of, for compiled callers."""
        return ErrorVectors(
            self._u,
            self._s,
            self._z,
            self._p,
            self._places,
            self._weights,
            self._process,
            self._work,
            self._theta,
            self._priors,
            self._orders,
            self._kept_of_orders,
            self._torque.state,
            self._position.state,
            self._k,
            *self._first,
        )

    def interrupt(self) -> None:
        """A cycle is missing, or can't be used: no mean goes across."""
        _act(_INTERRUPT, *self.vectors, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def go_by(self, cycle_s: float) -> None:
        """A cycle is so long from the next on: what is known stays. Its vectors are others then."""
        self._set_cycle(cycle_s)
        self.interrupt()

    def hold(self, duration_s: float) -> None:
        """Nothing can be measured: what is known gets less."""
        self.interrupt()
        s, f = self._s, filters
        now_N2, prior_N2 = s[f.SPREAD_N] ** 2, s[f.PRIOR_N2]
        if now_N2 < _MOST_FORGOTTEN * prior_N2:
            s[f.SPREAD_N] = sqrt(now_N2 + duration_s / _FORGOTTEN_S * prior_N2)

    def release(self) -> None:
        """The web is another one: its E may be, too."""
        self.interrupt()
        self._p[:, filters.E, filters.E] += _INITIAL_E**2

    def know(self, modulus_Pa: float, deviation_Pa: float, friction_N: float, friction_deviation_N: float) -> None:
        """Something else than what is learned here tells E, and dry friction beyond the model's."""
        reference_Pa = self._k.item(_REFERENCE_PA)
        sway = filters.SWAY
        self._z[:, sway] = self._p[:, sway, :] = self._p[:, :, sway] = 0.0  # no web has come in since that is known
        for place, value, deviation in (
            (filters.E, modulus_Pa / reference_Pa, deviation_Pa / reference_Pa),
            (filters.DRY, friction_N, friction_deviation_N),
        ):
            has_it = np.any(self._places == place, axis=1)
            self._z[has_it, place] = value
            self._p[:, place, :] = self._p[:, :, place] = 0.0
            self._p[has_it, place, place] = deviation**2

    @property
    def correction_N(self) -> float:
        """Force in the balance that is believed to be no tension."""
        return self._s.item(filters.CORRECTION_N)

    @property
    def rebased_N(self) -> float:
        """By how much more the correction is than with what was known in the cycle before."""
        return self._s.item(filters.REBASED_N)

    @property
    def deviation_N(self) -> float:
        """What the correction may be wrong by, standard deviation."""
        return self._s.item(filters.SPREAD_N)

    def update(self, now: BalanceSample, torque_Nm: float, x1_m: float, next_N: float, told_Pa: float) -> float:
        """Take the balance of this cycle; returns what of its force is no tension."""
        balance = (now.force_N, now.web_per_Pa, now.velocity_m_s)
        _act(_UPDATE, *self.vectors, x1_m, now.x2_m, torque_Nm, *balance, next_N, told_Pa)
        return self.correction_N

    def found(self) -> tuple[Nuisance, ...]:
        """What is estimated beside E by now, by the filter that allows for all of it; of an eccentricity (of roller 2,
        and of one of equal radius before it) the amplitude. The mass is that by which the measured torque accelerates:
        its error and that of the torque's scale are told together, which of them it is by nothing that they do."""
        mean, deviations = self._z[-1], np.sqrt(np.diag(self._p[-1]))
        rows = []
        for name, place in _NAMES.items():
            unit = self._force_per_torque if place == filters.OFFSET else 1.0
            deviation, prior = deviations.item(place), self._priors.item(place)
            rows.append(Nuisance(name, mean.item(place) / unit, deviation / unit, deviation < _SEPARABLE * prior))
        both = [filters.SCALE, filters.MASS]
        deviation = _ALIKE_IN_A_RAMP * sqrt(self._p[-1][np.ix_(both, both)].sum())
        separable = deviation < _SEPARABLE * self._priors.item(filters.MASS)
        rows.append(Nuisance("inertia_share", float(mean[both].sum()), deviation, separable))
        wobble = slice(filters.COS2, filters.COS2 + 2)
        deviation = float(np.hypot(*deviations[wobble]))
        separable = deviation < _SEPARABLE * float(np.hypot(*self._priors[wobble]))
        radius_m = self._radius_m
        rows.append(
            Nuisance("eccentricity_m", float(np.hypot(*mean[wobble])) * radius_m, deviation * radius_m, separable)
        )
        return tuple(rows)
