"""Inertia by a bank of Kalman filters (`kalman`), one for each hypothesis of when it last changed (`bank`)."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from math import expm1, hypot, log, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, arrays_in, compiled, entry_point, reals, record_type, table_of
from hilbench.estimation import bank, motion_filter
from hilbench.estimation.assumptions import SEPARABLE
from hilbench.estimation.bank import BankArrays, Places
from hilbench.estimation.motion_filter import wandered
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.servo_axis import balance, kalman
from hilbench.estimation.servo_axis.balance import InputArrays, ShaftSample
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
#: Deviation of β at the start, growth of its variance without usable sample; lasting error of the inertia; share from
#: which on it is separable; rates of births; the model's values of the nuisance parameters.
FIGURES: Final = np.dtype(
    [
        *record_type("initial_deviation", "hold_growth_per_s", "unmodelled", "separable").descr,
        *record_type("jumps_per_s", "drift_onsets_per_s").descr,
        ("of_model", "f8", (kalman.TERMS,)),
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


@compiled
def _begin(v: InertiaArrays) -> None:
    """Reset to the model's inertia with the initial deviation; the motion is to be placed, not the estimate of the
    shaft."""
    motion_filter.new_filter(v.bank, 0, v.figures.initial_deviation, v.inputs.u.priors)
    bank.begin(v.bank)
    v.stated.inertia_kg_m2, v.inputs.s.lost = 0.0, 1.0


@compiled
def update(v: InertiaArrays, position_rad: float, torque_Nm: float, ripple_Nm: float) -> None:
    """Take a sample: step every hypothesis and add the births of the next."""
    s, u, b, figures = v.inputs.s, v.inputs.u, v.bank, v.figures
    usable = balance.take(v.inputs, position_rad, torque_Nm, ripple_Nm)
    if balance.is_lost(s):
        s.lost = 1.0
    if usable:
        if s.lost != 0.0 or s.in_doubt != 0.0:
            speed = u.regressors[1]
            motion_filter.lose_motion(b, _PLACED_RAD2)
            for i in range(b.z.shape[1]):
                b.z[motion_filter.X, i], b.z[motion_filter.V, i] = position_rad - u.duration_s * speed, speed
            s.lost = 0.0
        b.births.cycle += 1.0
        bank.set_priors(b, figures.jumps_per_s, figures.drift_onsets_per_s, u.duration_s)
        # No shaft turns against its torque: an invalid estimate was misled, e.g. by a strong ripple that the model
        # lacks.
        if not _step(v):
            _begin(v)
    _state_estimate(v)


@compiled
def hold(v: InertiaArrays, duration_s: float, usable: bool) -> None:
    """Hold the estimate over a time without sample, deviation growing. The next one is compared over all the time since
    the last; where this one is not `usable` the motion is initialized anew."""
    p, out, u, added = v.bank.p, v.bank.out, v.inputs.u, v.figures.hold_growth_per_s * duration_s
    balance.miss(v.inputs, usable)
    if balance.is_lost(v.inputs.s):
        v.inputs.s.lost = 1.0
    for i in range(p.shape[2]):
        p[kalman.BETA, kalman.BETA, i] += wandered(p[kalman.BETA, kalman.BETA, i], added, u.parameter_bound)
    variance = out[1, kalman.BETA] ** 2
    out[1, kalman.BETA] = sqrt(variance + wandered(variance, added, u.parameter_bound))
    _state_estimate(v)


#: Actions on an estimator: start; take a sample; skip a cycle without one; hold.
_BEGIN, _UPDATE, _MISS, _HOLD = range(4)


@entry_point(COUNT, reals(3), TABLE)
def _act(what: int, values: tuple[float, ...], table: Places) -> None:
    v = arrays_in(table, InertiaArrays)
    if what == _UPDATE:
        update(v, values[0], values[1], values[2])
    elif what == _BEGIN:
        _begin(v)
        _state_estimate(v)
    else:
        hold(v, values[0], what == _MISS)


@dataclass(frozen=True, slots=True)
class ShaftEstimate:
    """Estimate of inertia and friction, with standard deviation."""

    inertia_kg_m2: float
    deviation_kg_m2: float  #: standard deviation
    separable: bool  #: False: (next to) no information on the inertia yet
    #: Friction and offset of the shaft, including the model's; unbalance beyond the model's.
    also: tuple[Nuisance, ...] = ()


#: Checkpoint of a shaft's estimate: means and covariances of the filters, hypotheses, mixture, births.
Known = tuple[NDArray[Any], ...]


class InertiaEstimator:
    """Estimator of an axis's inertia and friction, one sample a cycle; starts at `model`."""

    def __init__(self, config: InertiaConfig, model: ServoAxisParameters) -> None:
        shaft, figures, stated = model.shaft, np.zeros(1, FIGURES), np.zeros(1, STATED)
        offset_Nm = look(lay.pack(model), 0.0)[2]
        figures["of_model"] = offset_Nm, shaft.viscous_friction_Nm_s_per_rad, shaft.coulomb_friction_Nm, 0.0, 0.0
        figures["initial_deviation"] = 0.01 * config.initial_deviation_pct
        figures["separable"] = SEPARABLE * 0.01 * config.initial_deviation_pct
        figures["unmodelled"], figures["jumps_per_s"] = 0.01 * config.unmodelled_pct, config.jumps_per_s
        figures["drift_onsets_per_s"] = config.drift_onsets_per_s
        figures["hold_growth_per_s"] = (0.01 * config.hold_growth_pct_per_s) ** 2
        filters = bank.new_bank(kalman.SIZE, np.arange(kalman.SIZE), config.jump_pct, config.drift_pct_per_s)
        #: For compiled callers of `update` and `hold`.
        self.arrays = InertiaArrays(balance.new_inputs(model, config), filters, figures, stated)
        self.stated: np.void = stated[0]  #: a `STATED`
        self._table = table_of(self.arrays)
        self._act(_BEGIN)

    def _act(self, what: int, *values: float) -> ShaftEstimate:
        _act(what, (*map(float, values), *(0.0,) * (3 - len(values))), self._table)
        return self.estimate

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time of the bus."""
        if self.arrays.inputs.s["cycle_s"][0] != cycle_s:
            balance.set_cycle_time(self.arrays.inputs, cycle_s)

    def update(self, sample: ShaftSample) -> ShaftEstimate:
        """Take a sample."""
        self.set_cycle_time(sample.cycle_s)
        return self._act(_UPDATE, sample.position_rad, sample.torque_Nm, sample.ripple_Nm)

    def miss(self, duration_s: float) -> ShaftEstimate:
        """Skip a cycle without sample: the next one is compared over all the time since the last."""
        return self._act(_MISS, duration_s)

    def hold(self, duration_s: float) -> ShaftEstimate:
        """Hold the estimate over a time without usable sample, deviation growing; the motion is initialized anew."""
        return self._act(_HOLD, duration_s)

    def known(self) -> Known:
        """Checkpoint of the present estimate, for `go_back`."""
        return deepcopy(self._kept())

    def go_back(self, known: Known) -> ShaftEstimate:
        """Restore a checkpoint; the motion is initialized anew."""
        for now, then in zip(self._kept(), known, strict=True):
            now[:] = then
        return self.hold(0.0)

    def _kept(self) -> Known:
        b = self.arrays.bank
        return b.z, b.p, b.hypotheses, b.out, b.births

    @property
    def estimate(self) -> ShaftEstimate:
        """Estimate of the last cycle."""
        inertia_kg_m2, deviation_kg_m2, separable, *_ = self.stated.item()
        mean, deviation, _ = self.arrays.bank.out[:, kalman.Q :]
        values, deviations = mean + self.arrays.figures["of_model"][0], deviation.tolist()
        priors = self.arrays.inputs.u["priors"][0].tolist()
        rows = zip(_NAMES, values.tolist(), deviations, priors, strict=True)
        also = tuple([Nuisance(n, v, d, d < SEPARABLE * prior) for n, v, d, prior in rows if prior > 0.0])
        return ShaftEstimate(inertia_kg_m2, deviation_kg_m2, separable != 0.0, also)
