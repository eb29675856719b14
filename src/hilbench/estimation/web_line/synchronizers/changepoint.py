"""Change-point estimator of E: bank of Kalman filters (`kalman`), one per hypothesis of its last change (`bank`)."""

from __future__ import annotations

from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np

from hilbench.compiled import COUNT, CUBE, INDICES, MATRIX, VECTOR, compiled, entry_point, reals
from hilbench.estimation import bank
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.config import ChangepointConfig
from hilbench.estimation.web_line.synchronizers import kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import (
    SEPARABLE,
    FilterInputs,
    InputVectors,
    Plant,
    fill,
    nuisances,
)


class BankVectors(NamedTuple):
    """Vectors of a `ChangepointSynchronizer`, for compiled callers."""

    inputs: InputVectors
    z: Array  #: means (SIZE, H) of the hypotheses
    p: Array  #: covariances (SIZE, SIZE, H)
    records: Array  #: as `bank` has them (H, RECORD)
    settings: Array
    places: Places  #: as of `kalman.step`
    work: Array  #: scratch (SIZE + 6, H)
    #: (3, SIZE): means and standard deviations of the mixture, and, of E, the deviation by noise alone.
    out: Array
    covariance: Array  #: (SIZE, SIZE) of the mixture, if nuisance parameters are estimated
    s: Array  #: stated E over the reference; reference E, Pa; deviation that slows it; nuisances flag


_STATED, _REFERENCE_PA, _CAUTIOUS, _BESIDE = range(4)


@compiled
def follow(
    b: BankVectors,
    cycle_s: float,
    torque_Nm: float,
    x2_m: float,
    force_N: float,
    web_per_Pa: float,
    velocity_m_s: float,
) -> bool:
    """Step all hypotheses by one cycle and add the births of the next; False for the first of a row of cycles."""
    if not fill(b.inputs, cycle_s, torque_Nm, x2_m, force_N, web_per_Pa, velocity_m_s):
        return False
    z, p, records, out, size = b.z, b.p, b.records, b.out, b.z.shape[0]
    b.settings[bank.CYCLE] += 1.0
    g, likelihoods, shares = b.work[size + 3], b.work[size + 4], b.work[size + 5]
    kalman.step(z, p, b.inputs.u, b.places, g, b.work, likelihoods)
    bank.reweight(records, likelihoods)
    bank.compare(records, shares)
    bank.mix(z, p, shares, b.places, out)
    if b.s[_BESIDE] != 0.0:
        bank.covariance(z, p, shares, out[0], b.covariance)
    variance = 0.0
    for i in range(len(shares)):
        if shares[i] != 0.0:
            apart = z[kalman.E, i] - out[0, kalman.E]
            variance += shares[i] * (kalman.spread_of_e(p, i) + apart * apart)
    out[2, kalman.E] = sqrt(variance)
    bank.births(z, p, records, b.settings, kalman.E, kalman.RATE)
    return True


@compiled
def set_held_share(b: BankVectors, of_what_is_held: float) -> None:
    """Update the stated E after a cycle; `of_what_is_held`: contribution of nuisance parameters held at 0,
    their prior."""
    s, out = b.s, b.out
    found = out[0, kalman.E] - of_what_is_held
    # A few samples after a jump the mixture still has their noise.
    share = min(1.0, (s[_CAUTIOUS] / out[2, kalman.E]) ** 2)
    s[_STATED] += share * (found - s[_STATED])


@compiled
def stated(b: BankVectors) -> tuple[float, float]:
    """Stated E and its deviation, Pa: that of the mixture, and the distance to its mean. Parameters held at their prior
    add their contribution to that distance."""
    apart, deviation = b.out[0, kalman.E] - b.s[_STATED], b.out[1, kalman.E]
    reference_Pa = b.s[_REFERENCE_PA]
    return b.s[_STATED] * reference_Pa, hypot(deviation, apart) * reference_Pa


@compiled
def rebase(b: BankVectors, change_Pa: float) -> None:
    """Shift E of every hypothesis."""
    change = change_Pa / b.s[_REFERENCE_PA]
    for i in range(b.z.shape[1]):
        b.z[kalman.E, i] += change
    b.out[0, kalman.E] += change
    b.s[_STATED] += change


@compiled
def separable(u: Array, places: Places, out: Array) -> bool:
    """True if the data separate all nuisance parameters from E; arguments: vectors of a bank."""
    for i in range(kalman.OFFSET, len(places)):
        place = places[i]
        if not out[1, place] < SEPARABLE * u[kalman.PRIORS + place - kalman.OFFSET]:
            return False
    return True


_NOTHING, _STEP, _PUBLISH, _REBASE = range(4)


@entry_point(COUNT, *[VECTOR] * 4, MATRIX, CUBE, MATRIX, VECTOR, INDICES, *[MATRIX] * 3, VECTOR, reals(6))
def _act(
    what: int,
    u: Array,
    inputs: Array,
    torque: Array,
    position: Array,
    z: Array,
    p: Array,
    records: Array,
    settings: Array,
    places: Places,
    work: Array,
    out: Array,
    covariance: Array,
    s: Array,
    values: tuple[float, ...],
) -> tuple[bool, float, float]:
    """True if a step was taken; stated E and its deviation."""
    done, of_filters = True, InputVectors(u, inputs, torque, position)
    b = BankVectors(of_filters, z, p, records, settings, places, work, out, covariance, s)
    if what == _STEP:
        done = follow(b, values[0], values[1], values[2], values[3], values[4], values[5])
    elif what == _PUBLISH:
        set_held_share(b, values[0])
    elif what == _REBASE:
        rebase(b, values[0])
    modulus_Pa, deviation_Pa = stated(b)
    return done, modulus_Pa, deviation_Pa


@entry_point(VECTOR, INDICES, MATRIX)
def _separable(u: Array, places: Places, out: Array) -> bool:
    return separable(u, places, out)


class ChangepointSynchronizer:
    """Estimator of E by a bank of Kalman filters."""

    def __init__(self, config: ChangepointConfig, of: Plant) -> None:
        self._config = config
        self._also = tuple(config.also)
        self._inputs = FilterInputs(of, config)
        self._places = kalman.places_of(self._inputs.priors)
        self._z = np.zeros((kalman.SIZE, bank.CAPACITY))
        self._p = np.zeros((kalman.SIZE, kalman.SIZE, bank.CAPACITY))
        self._records = np.zeros((bank.CAPACITY, bank.RECORD))
        self._settings = np.zeros(bank.SETTINGS)
        self._settings[bank.JUMP_VARIANCE] = (0.01 * config.jump_pct) ** 2
        self._settings[bank.DRIFT_VARIANCE] = (0.01 * config.drift_pct_per_s) ** 2
        self._inputs.u[kalman.E_VARIANCE_PER_S] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self._work = np.zeros((kalman.SIZE + 6, bank.CAPACITY))
        self._out = np.zeros((3, kalman.SIZE))
        # Before the first sample E is the initial assumption.
        self._out[0, kalman.E], self._out[1, kalman.E] = 1.0, 0.01 * config.initial_deviation_pct
        self._covariance = np.zeros((kalman.SIZE, kalman.SIZE))
        self._beside = bool(self._inputs.priors[:-1].any())
        self._s = np.array([1.0, of.youngs_modulus_Pa, 0.01 * config.cautious_pct, float(self._beside)])
        self._started = False

    @property
    def vectors(self) -> BankVectors:
        """Vectors of the bank, for compiled callers."""
        return BankVectors(
            self._inputs.vectors,
            self._z,
            self._p,
            self._records,
            self._settings,
            self._places,
            self._work,
            self._out,
            self._covariance,
            self._s,
        )

    @property
    def is_compiled(self) -> bool:
        """True if `follow` and `set_held_share` are a complete update: started, and without nuisance parameters."""
        return self._started and not self._beside

    def update(self, sample: SyncSample) -> Estimate:
        """Step every hypothesis by one cycle and add the births of the next."""
        if not self._started:
            self._start(sample)
        balance = sample.balance
        now = (balance.x2_m, balance.force_N, balance.web_per_Pa, balance.velocity_m_s)
        if self._act(_STEP, sample.cycle_s, sample.torque_real_Nm, *now):
            self._act(_PUBLISH, self._of_what_is_held() if self._beside else 0.0)
        return self.estimate

    def _act(self, what: int, *values: float) -> bool:
        inputs, *own = self.vectors
        padded = (*map(float, values), *(0.0,) * (6 - len(values)))
        arguments: list[Any] = [what, *inputs, *own, padded]
        done, self._modulus_Pa, self._deviation_Pa = _act(*arguments)
        return done

    def _of_what_is_held(self) -> float:
        """Contribution to E of nuisance parameters that the data don't separate from it: they are held at 0, their
        prior."""
        priors, deviations = self._inputs.priors, self._out[1, kalman.OFFSET :]
        held = kalman.OFFSET + np.flatnonzero((priors > 0.0) & (deviations >= SEPARABLE * priors))
        if not held.size:
            return 0.0
        gain = np.linalg.solve(self._covariance[np.ix_(held, held)], self._covariance[held, kalman.E])
        return float(gain @ self._out[0, held])

    def _start(self, sample: SyncSample) -> None:
        c = self._config
        bank.set_priors(self._settings, c.jumps_per_s, c.drift_onsets_per_s, sample.cycle_s)
        deviation = 0.01 * c.initial_deviation_pct
        kalman.new_filter(self._z, self._p, 0, sample.balance.x2_m, deviation, self._inputs.priors)
        self._records[0, bank.ALIVE] = 1.0
        self._out[0] = self._z[:, 0]
        self._out[1] = np.sqrt(np.diag(self._p[:, :, 0]))
        self._started = True

    def rebase(self, change_Pa: float) -> None:
        """Shift E of every hypothesis."""
        self._act(_REBASE, change_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Widen E in every hypothesis (random walk); reset position and velocity."""
        self._inputs.interrupt()
        walk = 0.01 * self._config.hold_growth_pct_per_s
        self._p[kalman.E, kalman.E] += walk**2 * duration_s
        kalman.lose_motion(self._p)
        self._out[1, kalman.E] = sqrt(self._out[1, kalman.E] ** 2 + walk**2 * duration_s)
        return self.estimate

    @property
    def estimate(self) -> Estimate:
        """Estimate of the last cycle."""
        self._act(_NOTHING)
        return Estimate(self._modulus_Pa, self._deviation_Pa, self.nuisances)

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters estimated in addition to E."""
        mean, deviation, _ = self._out.tolist()
        return nuisances(self._also, mean[kalman.OFFSET :], deviation[kalman.OFFSET :])

    @property
    def separable(self) -> bool:
        """True if the data separate all nuisance parameters from E."""
        return _separable(self._inputs.u, self._places, self._out)
