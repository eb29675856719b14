"""Inertia by a bank of Kalman filters (`kalman`), one for each hypothesis of when it last changed (`bank`)."""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1, hypot, log, sqrt
from typing import Final, NamedTuple

import numpy as np

from hilbench.compiled import REAL, TABLE, VECTOR, compiled, entry_point, floats, integers, merged, table_of
from hilbench.estimation import bank
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.servo_axis import balance, kalman
from hilbench.estimation.servo_axis.balance import LOST, FilterInputs, InputVectors, ShaftSample
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import look

#: Nuisance parameters, in the order of the filter's state.
_NAMES = (
    "torque_offset_Nm",
    "viscous_friction_Nm_s_per_rad",
    "coulomb_friction_Nm",
    "unbalance_sine_Nm",
    "unbalance_cosine_Nm",
)
#: A parameter counts as found when the data have shrunk its prior deviation to this share.
_FOUND = 0.7
#: Least ratio of the model's inertia to the estimate; below it the estimate is invalid.
_LEAST_BETA = 0.01


class BankVectors(NamedTuple):
    """Vectors of the bank, for compiled callers: means and covariances of the filters, records, settings, indices of
    all states, scratch, means and standard deviations of the mixture, figures."""

    z: Array
    p: Array
    records: Array
    settings: Array
    places: Places
    work: Array
    out: Array
    figures: Array


#: Time without information on the inertia, after the settings of the bank; most jumps expected by then.
_QUIET_S, _LONGEST_QUIET = bank.SETTINGS, 20.0
#: Share outside an interval of 95 %: a less probable jump in quiet time does not widen it.
_LEFT_OUT = 0.05
#: Standard deviations of the mixture by which the stated value may differ from its mean, once it is separable; one
#: before.
_CAUTION = 0.3
#: Number of the cycle after which the bank's next is that of a large jump.
_BEFORE_LARGE_JUMP = 3.0
#: Figures: priors of a birth for a cycle; lasting error of the inertia, and the share from which on it is separable;
#: rate of its jumps; then the prior deviations of the nuisance parameters, and the model's values.
_LOG_JUMP, _LOG_DRIFT, _UNMODELLED, _SEPARABLE, _JUMPS_PER_S, PRIORS = range(6)
OF_MODEL: Final = PRIORS + kalman.TERMS
#: Stated values (7,): inertia and its deviation, separable flag; viscous and dry friction, including the model's, and
#: their deviations, 0 where they are not estimated.
INERTIA, DEVIATION, SEPARABLE, VISCOUS, COULOMB, VISCOUS_SD, COULOMB_SD = range(7)
#: Rows of a table of an estimator: those of its inputs, then those of the bank.
_BANK_ROW: Final = len(InputVectors._fields)
ROWS: Final = _BANK_ROW + len(BankVectors._fields)


@compiled
def _step(v: BankVectors, u: Array) -> bool:
    """Step all hypotheses by one cycle; False if the estimate is invalid.

    In quiet time, without acceleration, none is born or compared. The possible change by then is one jump, the more
    probable the longer it has been quiet: part of the stated deviation, and the first birth after it.
    """
    size, work = v.z.shape[0], v.work
    rows, g, likelihoods, shares = work[: size + 3], work[size + 5 :], work[size + 3], work[size + 4]
    excited, was_quiet = u[kalman.ACCELERATION_RAD_S2] != 0.0, v.settings[_QUIET_S] > 0.0
    if excited and was_quiet:
        v.settings[bank.LOG_JUMP] = max(log(_jump_odds(v)), v.settings[bank.LOG_JUMP])
        bank.births(v.z, v.p, v.records, v.settings, kalman.BETA, kalman.RATE)
        v.settings[_QUIET_S] = 0.0
    kalman.step(v.z, v.p, u, v.places, g, rows, likelihoods)
    bank.reweight(v.records, likelihoods)
    bank.compare(v.records, shares)
    bank.mix(v.z, v.p, shares, v.places, v.out)
    if not excited:
        v.settings[_QUIET_S] += u[kalman.DURATION_S]
        v.settings[bank.CYCLE] = _BEFORE_LARGE_JUMP
    elif not was_quiet:
        bank.births(v.z, v.p, v.records, v.settings, kalman.BETA, kalman.RATE)
    return bool(v.out[0, kalman.BETA] > _LEAST_BETA)


@compiled
def _jump_odds(v: BankVectors) -> float:
    """Odds of a jump of the inertia in quiet time."""
    return expm1(min(v.figures[_JUMPS_PER_S] * v.settings[_QUIET_S], _LONGEST_QUIET))


@compiled
def _state_estimate(v: BankVectors, inertia_kg_m2: float, stated: Array) -> None:
    """Update `stated` from the mixture; `inertia_kg_m2`: the model's.

    The inertia is held as far as the mixture is uncertain: a jump that is only probable moves the deviation, which is
    that about the stated value, and not the value by the noise of a newborn hypothesis.
    """
    mean, odds = v.out[0, kalman.BETA], _jump_odds(v)
    unseen = max(odds / (1.0 + odds) - _LEFT_OUT, 0.0)
    deviation = sqrt(v.out[1, kalman.BETA] ** 2 + unseen * v.settings[bank.JUMP_VARIANCE])
    beta = inertia_kg_m2 / stated[INERTIA] if stated[INERTIA] > 0.0 else mean
    apart = deviation * min(hypot(_CAUTION, deviation / (mean * v.figures[_SEPARABLE])), 1.0)
    beta = min(max(beta, mean - apart), mean + apart)
    stated[INERTIA] = inertia_kg_m2 / beta
    share = hypot(deviation, beta - mean) / beta
    stated[DEVIATION] = stated[INERTIA] * hypot(share, v.figures[_UNMODELLED])
    stated[SEPARABLE] = 1.0 if share < v.figures[_SEPARABLE] else 0.0
    stated[VISCOUS] = v.out[0, kalman.Q + 1] + v.figures[OF_MODEL + 1]
    stated[COULOMB] = v.out[0, kalman.Q + 2] + v.figures[OF_MODEL + 2]
    stated[VISCOUS_SD], stated[COULOMB_SD] = v.out[1, kalman.Q + 1], v.out[1, kalman.Q + 2]


@merged
def of_table(table: Places, first: int) -> BankVectors:
    """Vectors in a table from this row on."""
    return BankVectors(
        floats(table, first, (1, 2)),
        floats(table, first + 1, (1, 2, 3)),
        floats(table, first + 2, (1, 2)),
        floats(table, first + 3, (1,)),
        integers(table, first + 4, (1,)),
        floats(table, first + 5, (1, 2)),
        floats(table, first + 6, (1, 2)),
        floats(table, first + 7, (1,)),
    )


#: Result of `take_next`: nothing done, all is the interpreter's; the bank was misled and restarts; a normal cycle.
NOT_NEXT, MISLED, TAKEN = range(3)


@compiled
def take_next(
    inputs: InputVectors, v: BankVectors, position_rad: float, torque_Nm: float, ripple_Nm: float, stated: Array
) -> int:
    """Compiled `InertiaEstimator.update` of a sample that `balance.take_next` accepts."""
    if not balance.take_next(inputs, position_rad, torque_Nm, ripple_Nm):
        return NOT_NEXT
    v.settings[bank.CYCLE] += 1.0
    v.settings[bank.LOG_JUMP], v.settings[bank.LOG_DRIFT] = v.figures[_LOG_JUMP], v.figures[_LOG_DRIFT]
    if not _step(v, inputs.u):
        return MISLED
    _state_estimate(v, inputs.u[kalman.INERTIA_KG_M2], stated)
    return TAKEN


@entry_point(TABLE, REAL, REAL, REAL, VECTOR)
def _take_next(table: Places, position_rad: float, torque_Nm: float, ripple_Nm: float, stated: Array) -> int:
    inputs, v = balance.of_table(table, 0), of_table(table, _BANK_ROW)
    return take_next(inputs, v, position_rad, torque_Nm, ripple_Nm, stated)


@entry_point(TABLE)
def _step_once(table: Places) -> bool:
    inputs, v = balance.of_table(table, 0), of_table(table, _BANK_ROW)
    return _step(v, inputs.u)


@entry_point(TABLE, REAL, VECTOR)
def _state_once(table: Places, inertia_kg_m2: float, stated: Array) -> None:
    v = of_table(table, _BANK_ROW)
    _state_estimate(v, inertia_kg_m2, stated)


@dataclass(frozen=True, slots=True)
class ShaftEstimate:
    """Estimate of inertia and friction, with standard deviation."""

    inertia_kg_m2: float
    deviation_kg_m2: float  #: standard deviation
    separable: bool  #: False: (next to) no information on the inertia yet
    #: Friction and offset of the shaft, including the model's; unbalance beyond the model's.
    also: tuple[Nuisance, ...] = ()


class Known(NamedTuple):
    """Checkpoint of a shaft's estimate: means and covariances of the filters, records, mixture, settings."""

    z: Array
    p: Array
    records: Array
    out: Array
    settings: Array


class InertiaEstimator:
    """Estimator of an axis's inertia and friction, one sample a cycle; starts at `model`."""

    def __init__(self, config: InertiaConfig, model: ServoAxisParameters) -> None:
        self._config = config
        self._inputs = FilterInputs(model, config)
        p = lay.pack(model)
        figures = np.zeros(OF_MODEL + kalman.TERMS)
        figures[_UNMODELLED] = 0.01 * config.unmodelled_pct
        figures[_SEPARABLE] = _FOUND * 0.01 * config.initial_deviation_pct
        figures[_JUMPS_PER_S] = config.jumps_per_s
        figures[PRIORS:OF_MODEL] = self._inputs.priors
        figures[OF_MODEL + 1] = model.shaft.viscous_friction_Nm_s_per_rad
        figures[OF_MODEL + 2] = model.shaft.coulomb_friction_Nm
        figures[OF_MODEL] = look(p, 0.0)[2]
        self._settings = np.zeros(bank.SETTINGS + 1)
        self._settings[bank.JUMP_VARIANCE] = (0.01 * config.jump_pct) ** 2
        self._settings[bank.DRIFT_VARIANCE] = (0.01 * config.drift_pct_per_s) ** 2
        self._z = np.zeros((kalman.SIZE, bank.CAPACITY))
        self._p = np.zeros((kalman.SIZE, kalman.SIZE, bank.CAPACITY))
        self._records = np.zeros((bank.CAPACITY, bank.RECORD))
        self._out = np.zeros((2, kalman.SIZE))
        work = np.zeros((2 * kalman.SIZE + 5, bank.CAPACITY))
        places = np.arange(kalman.SIZE)
        self._bank = BankVectors(self._z, self._p, self._records, self._settings, places, work, self._out, figures)
        self._cycle_s = 0.0  # cycle time of the birth priors
        #: Stated values, by INERTIA and so on.
        self.stated = np.zeros(COULOMB_SD + 1)
        self._begin()
        self._gather()
        self._state_estimate()

    def _gather(self) -> None:
        """Collect the current vectors and the table of their addresses."""
        self._gathered = self._inputs.vectors
        self._table = table_of((*self._gathered, *self._bank))

    @property
    def table(self) -> Places:
        """Addresses of the vectors, for compiled callers of `take_next`; replaced whenever the vectors are."""
        if self._gathered is not self._inputs.vectors:
            self._gather()
        return self._table

    def _begin(self) -> None:
        """Reset to the model's inertia with the initial deviation."""
        self._records[:] = 0.0
        deviation = 0.01 * self._config.initial_deviation_pct
        kalman.new_filter(self._z, self._p, 0, deviation, self._inputs.priors)
        self._records[0, bank.ALIVE] = 1.0
        self._settings[_QUIET_S] = self.stated[INERTIA] = 0.0
        self._out[0] = self._z[:, 0]
        self._out[1] = np.sqrt(np.diag(self._p[:, :, 0]))
        self._lose(lost=True)  # the motion, not the estimate of the shaft

    def _lose(self, *, lost: bool) -> None:
        self._inputs.vectors.s[LOST] = lost

    def _state_estimate(self) -> None:
        _state_once(self.table, self._inputs.inertia_kg_m2, self.stated)

    def update(self, sample: ShaftSample) -> ShaftEstimate:
        """Step every hypothesis and add the births of the next."""
        measured = sample.position_rad, sample.torque_Nm, sample.ripple_Nm
        return self.go_on_from(_take_next(self.table, *measured, self.stated), sample)

    def go_on_from(self, stage: int, sample: ShaftSample) -> ShaftEstimate:
        """Run the interpreted rest of a cycle after `take_next`."""
        if stage == NOT_NEXT:
            self._update(sample)
        elif stage == MISLED:
            self._begin()
        if stage != TAKEN:
            self._state_estimate()
        return self.estimate

    def _update(self, sample: ShaftSample) -> None:
        usable = self._inputs.update(sample)
        if self._inputs.lost:
            self._lose(lost=True)
        if not usable:
            return
        if self._inputs.vectors.s[LOST] or self._inputs.in_doubt:
            speed = self._inputs.speed_rad_s
            kalman.place_motion(self._z, self._p, sample.position_rad - self._inputs.duration_s * speed, speed)
            self._lose(lost=False)
        self._settings[bank.CYCLE] += 1.0
        self._put_priors(sample.cycle_s)
        # No shaft turns against its torque: an invalid estimate was misled, e.g. by a strong ripple that the model
        # lacks.
        if not _step_once(self.table):
            self._begin()

    def _put_priors(self, cycle_s: float) -> None:
        """Set the birth priors for the time from the previous sample to the last."""
        c, figures = self._config, self._bank.figures
        if self._cycle_s != cycle_s:
            bank.set_priors(self._settings, c.jumps_per_s, c.drift_onsets_per_s, cycle_s)
            figures[_LOG_JUMP], figures[_LOG_DRIFT] = self._settings[bank.LOG_JUMP], self._settings[bank.LOG_DRIFT]
            self._cycle_s = cycle_s
        bank.set_priors(self._settings, c.jumps_per_s, c.drift_onsets_per_s, self._inputs.duration_s)

    def miss(self, duration_s: float) -> ShaftEstimate:
        """Skip a cycle without sample: the next one is compared over all the time since the last."""
        self._inputs.miss()
        return self._less_sure(duration_s)

    def hold(self, duration_s: float) -> ShaftEstimate:
        """Hold the estimate over a time without usable sample, deviation growing; the motion is initialized anew."""
        self._inputs.interrupt()
        return self._less_sure(duration_s)

    def known(self) -> Known:
        """Checkpoint of the present estimate, for `go_back`."""
        return Known(*[each.copy() for each in self._kept()])

    def go_back(self, known: Known) -> ShaftEstimate:
        """Restore a checkpoint; the motion is initialized anew."""
        for now, then in zip(self._kept(), known, strict=True):
            now[:] = then
        self._inputs.interrupt()
        self._lose(lost=True)
        self._state_estimate()
        return self.estimate

    def _kept(self) -> Known:
        return Known(self._z, self._p, self._records, self._out, self._settings)

    def _less_sure(self, duration_s: float) -> ShaftEstimate:
        if self._inputs.lost:
            self._lose(lost=True)
        added = (0.01 * self._config.hold_growth_pct_per_s) ** 2 * duration_s
        bound, variances = (0.01 * self._config.jump_pct) ** 2, self._p[kalman.BETA, kalman.BETA]
        variances += added * np.maximum(1.0 - variances / bound, 0.0)
        variance = self._out[1, kalman.BETA] ** 2
        self._out[1, kalman.BETA] = sqrt(variance + added * max(1.0 - variance / bound, 0.0))
        self._state_estimate()
        return self.estimate

    @property
    def estimate(self) -> ShaftEstimate:
        """Estimate of the last cycle."""
        inertia, deviation_kg_m2, separable = self.stated[: SEPARABLE + 1].tolist()
        values = self._out[0, kalman.Q :] + self._bank.figures[OF_MODEL:]
        deviations, priors = self._out[1, kalman.Q :].tolist(), self._inputs.priors.tolist()
        rows = zip(_NAMES, values.tolist(), deviations, priors, strict=True)
        also = tuple([Nuisance(n, v, d, d < _FOUND * prior) for n, v, d, prior in rows if prior > 0.0])
        return ShaftEstimate(inertia, deviation_kg_m2, separable != 0.0, also)
