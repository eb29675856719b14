"""Bank of Kalman filters (`kalman`) on the samples of a span: their inputs, a cycle, and the stated E; compiled.

`changepoint` runs a bank of hypotheses (`bank`), `ekf` one filter alone.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Reals2,
    arrays_in,
    compiled,
    entry_point,
    reals,
    record_type,
    table_of,
)
from hilbench.estimation import bank, motion_filter, noise_level
from hilbench.estimation.assumptions import POSITION_FLOOR_M, POSITION_NOISE_M, SEPARABLE, SHAKING, TORQUE_FLOOR_NM
from hilbench.estimation.bank import BankArrays, Places
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.web_line.config import ChangepointConfig, EkfConfig
from hilbench.estimation.web_line.synchronizers import kalman
from hilbench.estimation.web_line.synchronizers.base import (
    Estimate,
    Plant,
    Synchronizer,
    SyncSample,
    estimate_of,
    prior_deviations,
)

#: Smoothing of the acceleration that the mass error is weighed by.
_ACCELERATION_S: Final = 0.02
#: Time over which tension changes count as noise if a nuisance parameter is separated from E by the tension, s;
#: smoothing of that change. Vibration of the roller shakes the strain as well, and has no information.
_QUICK_S, _QUICK_SMOOTHING_S = 0.15, 0.02
#: True if there is a cycle before, its force and web; smoothed speed and tension; sizes of the plant: variance of the
#: force per variance of torque and position; true if a nuisance parameter is separated from E by the tension.
_CYCLE: Final = record_type(
    *("has_before", "before_N", "before_per_Pa", "smoothed_m_s", "smoothed_web_N"),
    *("modulus_Pa", "mass_kg", "per_torque2", "per_position2", "slowly"),
)
#: Stated E over the reference; reference E; deviation that slows it; true if nuisance parameters are estimated.
_STATED: Final = record_type("modulus", "reference_Pa", "cautious", "has_nuisances")


class FilterArrays(NamedTuple):
    """A bank of filters with its inputs, for compiled callers."""

    inputs: Annotated[Any, kalman.INPUTS]
    cycle: Annotated[Any, _CYCLE]
    torque: Reals  #: state of the torque's `NoiseLevel`
    position: Reals  #: the same of the position's
    bank: BankArrays
    covariance: Reals2  #: (SIZE, SIZE) of the mixture, if nuisance parameters are estimated
    stated: Annotated[Any, _STATED]


@compiled
def _fill(f: FilterArrays, sample: tuple[float, ...]) -> bool:
    """Fill the inputs by the balance of this cycle: means over the cycle, and their noise; False for the first of a
    row, which has no previous cycle. `sample`: cycle time, torque, position of roller 2, force, h = F/E, speed."""
    cycle_s, torque_Nm, x2_m, force_N, web_per_Pa, velocity_m_s = sample
    u, s = f.inputs, f.cycle
    noise_level.take(f.torque, torque_Nm)
    noise_level.take(f.position, x2_m)
    has_before, before_N, before_per_Pa = s.has_before, s.before_N, s.before_per_Pa
    s.has_before = 1.0
    s.before_N = force_N
    s.before_per_Pa = web_per_Pa
    if has_before == 0.0:
        s.smoothed_m_s = velocity_m_s
        s.smoothed_web_N = web_per_Pa * s.modulus_Pa
        u.acceleration_m_s2 = 0.0
        return False
    slope = (velocity_m_s - s.smoothed_m_s) / (_ACCELERATION_S + cycle_s)
    s.smoothed_m_s += slope * cycle_s
    u.acceleration_m_s2 = slope
    position_variance = noise_level.variance(f.position)
    u.duration_s = cycle_s
    u.force_N = 0.5 * (force_N + before_N)
    u.web_N = 0.5 * (web_per_Pa + before_per_Pa) * s.modulus_Pa
    u.speed_m_s = velocity_m_s
    # The strain is a difference of two positions, so their noise is noise of the tension.
    u.force_variance = (
        s.per_torque2 * noise_level.variance(f.torque)
        + s.per_position2 * position_variance
        + (SHAKING * s.mass_kg * slope) ** 2
    )
    if s.slowly != 0.0:
        web_N_per_s = (u.web_N - s.smoothed_web_N) / (_QUICK_SMOOTHING_S + cycle_s)
        s.smoothed_web_N += web_N_per_s * cycle_s
        u.force_variance += (_QUICK_S * web_N_per_s) ** 2
    u.position = x2_m
    u.position_variance = position_variance
    return True


@compiled
def follow(f: FilterArrays, sample: tuple[float, ...]) -> bool:
    """Step all hypotheses by one cycle (`_fill`) and add the births of the next; False for the first of a row of
    cycles."""
    if not _fill(f, sample):
        return False
    b = f.bank
    z, p, out, shares = b.z, b.p, b.out, b.shares
    b.births.cycle += 1.0
    kalman.step(b, f.inputs)
    bank.compare(b)
    if f.stated.has_nuisances != 0.0:
        bank.covariance(b, f.covariance)
    variance = 0.0
    for i in range(len(shares)):
        if shares[i] != 0.0:
            apart, spread = z[kalman.E, i] - out[0, kalman.E], p[kalman.E, kalman.E, i]
            for j in range(kalman.OFFSET, kalman.SIZE):  # by noise alone, without that of nuisance parameters
                if p[j, j, i] > 0.0:
                    spread -= p[kalman.E, j, i] * p[kalman.E, j, i] / p[j, j, i]
            variance += shares[i] * (max(spread, 0.0) + apart * apart)
    out[2, kalman.E] = sqrt(variance)
    bank.give_birth(b, kalman.E, motion_filter.RATE)
    return True


@compiled
def state(f: FilterArrays, of_what_is_held: float) -> None:
    """Update the stated E after a cycle; `of_what_is_held`: contribution of nuisance parameters held at 0, their
    prior."""
    s, out = f.stated, f.bank.out
    found = out[0, kalman.E] - of_what_is_held
    # A few samples after a jump the mixture still has their noise.
    share = min(1.0, (s.cautious / out[2, kalman.E]) ** 2)
    s.modulus += share * (found - s.modulus)


@compiled
def stated(f: FilterArrays) -> tuple[float, float]:
    """Stated E and its deviation, Pa: that of the mixture, and the distance to its mean. Parameters held at their prior
    add their contribution to that distance."""
    s, out = f.stated, f.bank.out
    apart, deviation = out[0, kalman.E] - s.modulus, out[1, kalman.E]
    return s.modulus * s.reference_Pa, hypot(deviation, apart) * s.reference_Pa


@compiled
def rebase(f: FilterArrays, change_Pa: float) -> None:
    """Shift E of every hypothesis."""
    b = f.bank
    change = change_Pa / f.stated.reference_Pa
    for i in range(b.z.shape[1]):
        b.z[kalman.E, i] += change
    b.out[0, kalman.E] += change
    f.stated.modulus += change


@compiled
def separable(f: FilterArrays) -> bool:
    """True if the data separate all nuisance parameters from E."""
    places = f.bank.places
    for i in range(kalman.OFFSET, len(places)):
        place = places[i]
        if not f.bank.out[1, place] < SEPARABLE * f.inputs.priors[place - kalman.OFFSET]:
            return False
    return True


#: Actions on the filters: none; start the first; fill the inputs; step the one filter alone, or all hypotheses; update
#: the stated E; shift E; hold.
NOTHING, START, FILL, STEP, FOLLOW, STATE, REBASE, HOLD = range(8)


@compiled
def _hold(f: FilterArrays, added: float) -> None:
    """Widen E in every filter (random walk); reset position and velocity; form no mean across the gap."""
    b, f.cycle.has_before = f.bank, 0.0
    for i in range(b.p.shape[2]):
        b.p[kalman.E, kalman.E, i] += added
    motion_filter.lose_motion(b, 1.0)
    b.out[1, kalman.E] = sqrt(b.out[1, kalman.E] * b.out[1, kalman.E] + added)


@entry_point(COUNT, reals(6), TABLE)
def _act(what: int, values: tuple[float, ...], table: Places) -> tuple[bool, float, float, bool]:
    """True if a step can be, or was, taken; stated E and its deviation; true if it is separable."""
    f, done = arrays_in(table, FilterArrays), True
    if what == START:
        motion_filter.new_filter(f.bank, 0, values[0], f.inputs.priors, values[1])
        bank.begin(f.bank)
        bank.set_priors(f.bank, values[2], values[3], values[4])
    elif what == FILL:
        done = _fill(f, values)
    elif what == STEP:
        kalman.step(f.bank, f.inputs)
    elif what == FOLLOW:
        done = follow(f, values)
    elif what == STATE:
        state(f, values[0])
    elif what == REBASE:
        rebase(f, values[0])
    elif what == HOLD:
        _hold(f, values[0])
    modulus_Pa, deviation_Pa = stated(f)
    return done, modulus_Pa, deviation_Pa, separable(f)


class Filters(Synchronizer):
    """Estimator of E by a bank of Kalman filters."""

    def __init__(
        self,
        config: EkfConfig | ChangepointConfig,
        plant: Plant,
        of_bank: tuple[float, float, int],
        births_per_s: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """`of_bank`: jumps and drifts of `bank.new_bank`, and its capacity; `births_per_s`: rates of jumps and of drift
        onsets."""
        self._births_per_s = births_per_s
        self._also, self._priors = config.also, prior_deviations(config.also)
        self._reference_Pa = plant.youngs_modulus_Pa
        self._hold_pct_per_s = config.hold_growth_pct_per_s
        self._initial_deviation = 0.01 * config.initial_deviation_pct
        places = np.array([*range(kalman.OFFSET), *(np.flatnonzero(self._priors) + kalman.OFFSET)], np.int64)
        stiffness_per_m = plant.youngs_modulus_Pa * plant.section_m2 / plant.span_length_m
        slowly = float(self._priors[:-1].any())
        self.arrays = FilterArrays(
            kalman.new_inputs(self._priors, plant.mass_kg, plant.force_per_torque_per_m),
            np.array(
                [
                    (
                        *(0.0, 0.0, 0.0, 0.0, 0.0, plant.youngs_modulus_Pa, plant.mass_kg),
                        *(plant.force_per_torque_per_m**2, 2.0 * stiffness_per_m**2, slowly),
                    )
                ],
                _CYCLE,
            ),
            NoiseLevel(config.torque_noise_Nm, TORQUE_FLOOR_NM).state,
            NoiseLevel(POSITION_NOISE_M, POSITION_FLOOR_M).state,
            bank.new_bank(kalman.SIZE, places, *of_bank),
            np.zeros((kalman.SIZE, kalman.SIZE)),
            np.array([(1.0, plant.youngs_modulus_Pa, 0.0, slowly)], _STATED),
        )
        self._table = table_of(self.arrays)
        self.inputs = self.arrays.inputs[0]
        # Before the first sample E is the initial assumption.
        self.arrays.bank.out[:2, kalman.E] = 1.0, self._initial_deviation
        self.started = False

    def act(self, what: int, *values: float) -> bool:
        """Act on the filters (NOTHING and so on)."""
        padded = (*map(float, values), *(0.0,) * (6 - len(values)))
        done, self._modulus_Pa, self._deviation_Pa, self._separable = _act(what, padded, self._table)
        return done

    def take(self, what: int, sample: SyncSample) -> bool:
        """FILL the inputs by a sample, or FOLLOW it; the first one starts the filter in the first column."""
        balance = sample.balance
        if not self.started:
            self.act(START, self._initial_deviation, balance.x2_m, *self._births_per_s, sample.cycle_s)
            self.started = True
        now = (balance.x2_m, balance.force_N, balance.web_per_Pa, balance.velocity_m_s)
        return self.act(what, sample.cycle_s, sample.torque_real_Nm, *now)

    def rebase(self, change_Pa: float) -> None:
        """Shift E of every filter."""
        self.act(REBASE, change_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Widen E in every filter (random walk); reset position and velocity."""
        walk = 0.01 * self._hold_pct_per_s
        self.act(HOLD, walk**2 * duration_s)
        return self.estimate

    @property
    def estimate(self) -> Estimate:
        """Estimate of the last cycle."""
        raise NotImplementedError

    def _estimate_by(self, means: Array, deviations: Array) -> Estimate:
        """Estimate by the states' means and deviations (SIZE,)."""
        states = [kalman.E, *kalman.NUISANCES]
        return estimate_of(self._also, self._reference_Pa, means[states], deviations[states])
