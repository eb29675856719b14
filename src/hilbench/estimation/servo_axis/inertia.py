"""Inertia by a bank of Kalman filters (`kalman`), one for each hypothesis of when it last changed (`bank`)."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from math import expm1, hypot, log, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, REAL, TABLE, arrays_in, compiled, entry_point, record_type, table_of
from hilbench.estimation import bank, motion_filter
from hilbench.estimation.assumptions import SEPARABLE
from hilbench.estimation.bank import Array, BankArrays, Places
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.servo_axis import balance, kalman
from hilbench.estimation.servo_axis.balance import FilterInputs, InputArrays, ShaftSample
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


#: Variance of a position that the filters are placed at: far above that of any encoder, far below a step of its path.
_PLACED_RAD2 = 1e-8
#: Most jumps expected by the end of a time without information on the inertia.
_LONGEST_QUIET = 20.0
#: Share outside an interval of 95 %: a less probable jump in quiet time does not widen it.
_LEFT_OUT = 0.05
#: Standard deviations of the mixture by which the stated value may differ from its mean, once it is separable; one
#: before.
_CAUTION = 0.3
#: Number of the cycle after which the bank's next is that of a large jump.
_BEFORE_LARGE_JUMP = 3.0
FIGURES: Final = np.dtype(
    [
        ("log_jump", "f8"),  # priors of a birth for a cycle
        ("log_drift", "f8"),
        ("unmodelled", "f8"),  # lasting error of the inertia
        ("separable", "f8"),  # share from which on it is separable
        ("jumps_per_s", "f8"),
        ("of_model", "f8", (kalman.TERMS,)),  # the model's values of the nuisance parameters
    ]
)
#: Stated values: inertia and its deviation, separable flag; viscous and dry friction, including the model's, and their
#: deviations, 0 where they are not estimated.
STATED: Final = record_type(
    *("inertia_kg_m2", "deviation_kg_m2", "separable", "viscous", "coulomb", "viscous_sd", "coulomb_sd")
)


class InertiaArrays(NamedTuple):
    """Arrays of an `InertiaEstimator`, for compiled callers."""

    inputs: InputArrays
    bank: BankArrays
    figures: Annotated[Any, FIGURES]
    stated: Annotated[Any, STATED]


@compiled
def _step(v: InertiaArrays) -> bool:
    """Step all hypotheses by one cycle; False if the estimate is invalid.

    In quiet time, without acceleration, none is born or compared. The possible change by then is one jump, the more
    probable the longer it has been quiet: part of the stated deviation, and the first birth after it.
    """
    b, births, u = v.bank, v.bank.births, v.inputs.u
    excited, was_quiet = u.acceleration_rad_s2 != 0.0, births.quiet_s > 0.0
    if excited and was_quiet:
        births.log_jump = max(log(_jump_odds(v)), births.log_jump)
        bank.give_birth(b, kalman.BETA, motion_filter.RATE)
        births.quiet_s = 0.0
    kalman.step(b, u)
    bank.compare(b)
    if not excited:
        births.quiet_s += u.duration_s
        births.cycle = _BEFORE_LARGE_JUMP
    elif not was_quiet:
        bank.give_birth(b, kalman.BETA, motion_filter.RATE)
    return bool(b.out[0, kalman.BETA] > kalman.LEAST_BETA)


@compiled
def _jump_odds(v: InertiaArrays) -> float:
    """Odds of a jump of the inertia in quiet time."""
    return expm1(min(v.figures.jumps_per_s * v.bank.births.quiet_s, _LONGEST_QUIET))


@compiled
def _state_estimate(v: InertiaArrays) -> None:
    """Update `stated` from the mixture.

    The inertia is held as far as the mixture is uncertain: a jump that is only probable moves the deviation, which is
    that about the stated value, and not the value by the noise of a newborn hypothesis.
    """
    out, figures, stated, inertia_kg_m2 = v.bank.out, v.figures, v.stated, v.inputs.u.inertia_kg_m2
    mean, odds = out[0, kalman.BETA], _jump_odds(v)
    unseen = max(odds / (1.0 + odds) - _LEFT_OUT, 0.0)
    deviation = sqrt(out[1, kalman.BETA] ** 2 + unseen * v.bank.births.jump_variance)
    beta = inertia_kg_m2 / stated.inertia_kg_m2 if stated.inertia_kg_m2 > 0.0 else mean
    apart = deviation * min(hypot(_CAUTION, deviation / (mean * figures.separable)), 1.0)
    beta = min(max(beta, mean - apart), mean + apart)
    stated.inertia_kg_m2 = inertia_kg_m2 / beta
    share = hypot(deviation, beta - mean) / beta
    stated.deviation_kg_m2 = stated.inertia_kg_m2 * hypot(share, figures.unmodelled)
    stated.separable = 1.0 if share < figures.separable else 0.0
    stated.viscous = out[0, kalman.Q + 1] + figures.of_model[1]
    stated.coulomb = out[0, kalman.Q + 2] + figures.of_model[2]
    stated.viscous_sd, stated.coulomb_sd = out[1, kalman.Q + 1], out[1, kalman.Q + 2]


#: Results of a cycle: nothing done, all is the interpreter's; the bank was misled and restarts; a normal cycle.
NOT_NEXT, MISLED, TAKEN = range(3)


@compiled
def take_next(v: InertiaArrays, position_rad: float, torque_Nm: float, ripple_Nm: float) -> int:
    """Compiled `InertiaEstimator.update` of a sample that `balance.take_next` accepts."""
    if not balance.take_next(v.inputs, position_rad, torque_Nm, ripple_Nm):
        return NOT_NEXT
    births = v.bank.births
    births.cycle += 1.0
    births.log_jump, births.log_drift = v.figures.log_jump, v.figures.log_drift
    if not _step(v):
        return MISLED
    _state_estimate(v)
    return TAKEN


#: Actions on an estimator: take the next sample; step the bank; update the stated values.
_TAKE, _STEP, _STATE = range(3)


@entry_point(COUNT, REAL, REAL, REAL, TABLE)
def _act(what: int, position_rad: float, torque_Nm: float, ripple_Nm: float, table: Places) -> int:
    v = arrays_in(table, InertiaArrays)
    if what == _TAKE:
        return take_next(v, position_rad, torque_Nm, ripple_Nm)
    if what == _STEP:
        return TAKEN if _step(v) else MISLED
    _state_estimate(v)
    return TAKEN


@dataclass(frozen=True, slots=True)
class ShaftEstimate:
    """Estimate of inertia and friction, with standard deviation."""

    inertia_kg_m2: float
    deviation_kg_m2: float  #: standard deviation
    separable: bool  #: False: (next to) no information on the inertia yet
    #: Friction and offset of the shaft, including the model's; unbalance beyond the model's.
    also: tuple[Nuisance, ...] = ()


class Known(NamedTuple):
    """Checkpoint of a shaft's estimate: means and covariances of the filters, hypotheses, mixture, births."""

    z: Array
    p: Array
    hypotheses: NDArray[np.void]
    out: Array
    births: NDArray[np.void]


class InertiaEstimator:
    """Estimator of an axis's inertia and friction, one sample a cycle; starts at `model`."""

    def __init__(self, config: InertiaConfig, model: ServoAxisParameters) -> None:
        self._config = config
        self._inputs = FilterInputs(model, config)
        shaft = model.shaft
        offset_Nm = look(lay.pack(model), 0.0)[2]
        of_model = offset_Nm, shaft.viscous_friction_Nm_s_per_rad, shaft.coulomb_friction_Nm, 0.0, 0.0
        separable = SEPARABLE * 0.01 * config.initial_deviation_pct
        figures = (0.0, 0.0, 0.01 * config.unmodelled_pct, separable, config.jumps_per_s, of_model)
        self._figures = np.array([figures], FIGURES)
        self._bank = bank.new_bank(kalman.SIZE, np.arange(kalman.SIZE), config.jump_pct, config.drift_pct_per_s)
        self._cycle_s = 0.0  # cycle time of the birth priors
        self._stated = np.zeros(1, STATED)
        self.stated: np.void = self._stated[0]  #: a `STATED`
        self._begin()
        self._gather()
        self._state_estimate()

    def _gather(self) -> None:
        """Collect the current arrays and the table of their addresses."""
        self.arrays = InertiaArrays(self._inputs.arrays, self._bank, self._figures, self._stated)
        self._table = table_of(self.arrays)

    @property
    def table(self) -> Places:
        """Addresses of the arrays, for compiled callers of `take_next`; replaced whenever the arrays are."""
        if self.arrays.inputs is not self._inputs.arrays:
            self._gather()
        return self._table

    def _begin(self) -> None:
        """Reset to the model's inertia with the initial deviation."""
        deviation = 0.01 * self._config.initial_deviation_pct
        motion_filter.new_filter(self._bank, 0, deviation, self._inputs.priors)
        self._bank.begin()
        self.stated["inertia_kg_m2"] = 0.0
        self._lose(lost=True)  # the motion, not the estimate of the shaft

    def _lose(self, *, lost: bool) -> None:
        self._inputs.arrays.s["lost"] = lost

    def _state_estimate(self) -> None:
        _act(_STATE, 0.0, 0.0, 0.0, self.table)

    def update(self, sample: ShaftSample) -> ShaftEstimate:
        """Step every hypothesis and add the births of the next."""
        measured = sample.position_rad, sample.torque_Nm, sample.ripple_Nm
        return self.go_on_from(_act(_TAKE, *measured, self.table), sample)

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
        if self._inputs.arrays.s["lost"][0] or self._inputs.in_doubt:
            speed = self._inputs.speed_rad_s
            before_rad = sample.position_rad - self._inputs.duration_s * speed
            self._bank.z[motion_filter.X], self._bank.z[motion_filter.V] = before_rad, speed
            motion_filter.lose_motion(self._bank, _PLACED_RAD2)
            self._lose(lost=False)
        self._bank.births["cycle"] += 1.0
        self._put_priors(sample.cycle_s)
        # No shaft turns against its torque: an invalid estimate was misled, e.g. by a strong ripple that the model
        # lacks.
        if _act(_STEP, 0.0, 0.0, 0.0, self.table) == MISLED:
            self._begin()

    def _put_priors(self, cycle_s: float) -> None:
        """Set the birth priors for the time from the previous sample to the last."""
        c, births = self._config, self._bank.births
        if self._cycle_s != cycle_s:
            self._bank.set_priors(c.jumps_per_s, c.drift_onsets_per_s, cycle_s)
            self._figures["log_jump"], self._figures["log_drift"] = births["log_jump"], births["log_drift"]
            self._cycle_s = cycle_s
        self._bank.set_priors(c.jumps_per_s, c.drift_onsets_per_s, self._inputs.duration_s)

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
        return deepcopy(self._kept())

    def go_back(self, known: Known) -> ShaftEstimate:
        """Restore a checkpoint; the motion is initialized anew."""
        for now, then in zip(self._kept(), known, strict=True):
            now[:] = then
        self._inputs.interrupt()
        self._lose(lost=True)
        self._state_estimate()
        return self.estimate

    def _kept(self) -> Known:
        return Known(self._bank.z, self._bank.p, self._bank.hypotheses, self._bank.out, self._bank.births)

    def _less_sure(self, duration_s: float) -> ShaftEstimate:
        if self._inputs.lost:
            self._lose(lost=True)
        added = (0.01 * self._config.hold_growth_pct_per_s) ** 2 * duration_s
        bound, variances = (0.01 * self._config.jump_pct) ** 2, self._bank.p[kalman.BETA, kalman.BETA]
        variances += added * np.maximum(1.0 - variances / bound, 0.0)
        out = self._bank.out
        variance = out[1, kalman.BETA] ** 2
        out[1, kalman.BETA] = sqrt(variance + added * max(1.0 - variance / bound, 0.0))
        self._state_estimate()
        return self.estimate

    @property
    def estimate(self) -> ShaftEstimate:
        """Estimate of the last cycle."""
        inertia_kg_m2, deviation_kg_m2, separable, *_ = self.stated.item()
        mean, deviation, _ = self._bank.out[:, kalman.Q :]
        values, deviations = mean + self._figures["of_model"][0], deviation.tolist()
        priors = self._inputs.priors.tolist()
        rows = zip(_NAMES, values.tolist(), deviations, priors, strict=True)
        also = tuple([Nuisance(n, v, d, d < SEPARABLE * prior) for n, v, d, prior in rows if prior > 0.0])
        return ShaftEstimate(inertia_kg_m2, deviation_kg_m2, separable != 0.0, also)
