"""Bank of Kalman filters, one for each hypothesis of when a parameter last jumped or began to drift.

They are mixed by evidence: Bayesian change-point detection (Adams and MacKay 2007) with a Kalman filter as the model of
a run, so that a hypothesis is weighed by its prediction of the next encoder position. Each young hypothesis is kept for
a while, whatever its weight, so that a small change has time to show; after that the least probable ones are dropped.
Between changes the mixture is one long-run filter with little noise; at a change the right hypothesis already exists,
and takes over as soon as the data prefer it. The deviation is that of the mixture: it is wide while it is undecided.

Three kinds of child are born of the most probable hypothesis: a *jump* of the watched parameter (large and small in
turn), a *drift* (a rate of it), and, of a drift, its *end*.

Means (n, H) and covariances (n, n, H) of all hypotheses are columns, with a record of each. The bank is
independent of the kind of filter: a cycle is a step of all filters, whose log likelihoods are added to their weights
(`compare`), then `give_birth`. Dropped filters are stepped with the others.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.compiled import Reals, Reals2, Reals3, Records, Wholes, compiled, record_type, records

#: Indices in a filter's state.
Places = NDArray[np.int64]

_JUMP, _DRIFT, _END = 0, 1, 2
#: Cycles between two births of a kind, and how long a newborn is kept whatever its weight.
_EVERY = (2, 50, 50)
_PROTECTED = (40, 500, 500)
#: Room for young hypotheses of every kind, and for established ones.
_YOUNG = sum(kept // every + 1 for every, kept in zip(_EVERY, _PROTECTED, strict=True))
CAPACITY = _YOUNG + 8
#: A hypothesis past its protection is dropped when it is less probable than the best by this factor (logarithm).
_HOPELESS = 12.0
_SMALL_JUMP = 0.15  #: size of the small jumps over that of the large ones

#: Log weight of a hypothesis, its kind, cycles since its birth; 0: it is dropped.
HYPOTHESIS: Final = np.dtype([("weight", "f8"), ("kind", "i8"), ("age", "f8"), ("alive", "f8")])
#: Priors of a birth (logarithms), variances of a jump and of a drift's rate, the cycle's number; time without
#: information on the watched parameter.
BIRTHS: Final = record_type("log_jump", "log_drift", "jump_variance", "drift_variance", "cycle", "quiet_s")


class BankArrays(NamedTuple):
    """A bank of filters with `size` states, for compiled callers."""

    z: Reals2  #: means (size, H) of the hypotheses
    p: Reals3  #: covariances (size, size, H)
    hypotheses: Annotated[Any, records(HYPOTHESIS)]
    births: Annotated[Any, BIRTHS]
    places: Wholes  #: indices of the states that the filters have
    work: Reals2  #: scratch (2 size + 3, H)
    likelihoods: Reals  #: log likelihoods (H,) of this cycle
    shares: Reals  #: probabilities (H,) of the hypotheses, 0 of dropped ones
    out: Reals2  #: means and standard deviations of the mixture; deviation of the watched parameter by noise alone


@compiled
def begin(b: BankArrays) -> None:
    """Restart from the filter in the first column alone."""
    for i in range(len(b.hypotheses)):
        b.hypotheses[i].weight = b.hypotheses[i].age = b.hypotheses[i].alive = 0.0
        b.hypotheses[i].kind = 0
    b.hypotheses[0].alive = 1.0
    b.births.quiet_s = 0.0
    for j in range(b.z.shape[0]):
        b.out[0, j], b.out[1, j] = b.z[j, 0], sqrt(b.p[j, j, 0])


@compiled
def set_priors(b: BankArrays, jumps_per_s: float, drift_onsets_per_s: float, cycle_s: float) -> None:
    """Set the prior of one birth from the rates of jumps and of drift onsets."""
    b.births.log_jump = log(jumps_per_s * _EVERY[_JUMP] * cycle_s)
    b.births.log_drift = log(drift_onsets_per_s * _EVERY[_DRIFT] * cycle_s)


def new_bank(
    size: int, places: Places, jump_pct: float, drift_pct_per_s: float, capacity: int = CAPACITY
) -> BankArrays:
    """Bank of filters with `size` states at these `places`, none of them alive; deviations of a jump of the watched
    parameter and of a drift's rate."""
    births = np.zeros(1, BIRTHS)
    births["jump_variance"], births["drift_variance"] = (0.01 * jump_pct) ** 2, (0.01 * drift_pct_per_s) ** 2
    filters = np.zeros((size, capacity)), np.zeros((size, size, capacity)), np.zeros(capacity, HYPOTHESIS)
    work, likelihoods, shares = np.zeros((2 * size + 3, capacity)), np.zeros(capacity), np.zeros(capacity)
    return BankArrays(*filters, births, places, work, likelihoods, shares, np.zeros((3, size)))


@compiled
def _free_place(hypotheses: Records) -> int:
    """Index of a hypothesis that may be replaced; -1: all are needed."""
    worst = -1
    for i in range(len(hypotheses)):
        if hypotheses[i].alive == 0.0:
            return i
        of_age = hypotheses[i].age >= _PROTECTED[hypotheses[i].kind]
        if of_age and (worst < 0 or hypotheses[i].weight < hypotheses[worst].weight):
            worst = i
    return worst


@compiled
def _best(hypotheses: Records) -> int:
    best = -1
    for i in range(len(hypotheses)):
        if hypotheses[i].alive != 0.0 and (best < 0 or hypotheses[i].weight > hypotheses[best].weight):
            best = i
    return best


@compiled
def _birth(
    b: BankArrays, kind: int, log_prior: float, watched: int, rate: int, variance: float, rate_variance: float
) -> None:
    """Add a child of the best hypothesis, with these variances added to the watched parameter and set for its rate."""
    z, p, hypotheses = b.z, b.p, b.hypotheses
    parent = _best(hypotheses)
    i = _free_place(hypotheses)
    if i < 0 or i == parent:
        return
    size = z.shape[0]
    for j in range(size):
        z[j, i] = z[j, parent]
        for k in range(size):
            p[j, k, i] = p[j, k, parent]
    z[rate, i] = 0.0
    for j in range(size):
        p[rate, j, i] = 0.0
        p[j, rate, i] = 0.0
    p[watched, watched, i] += variance
    p[rate, rate, i] = rate_variance
    hypotheses[i].weight = hypotheses[parent].weight + log_prior
    hypotheses[i].kind = kind
    hypotheses[i].age = 0.0
    hypotheses[i].alive = 1.0


@compiled
def give_birth(b: BankArrays, watched: int, rate: int) -> None:
    """Add the children of this cycle; `watched` and `rate` are indices in the filters' state."""
    births = b.births
    cycle = int(births.cycle)
    if cycle % _EVERY[_JUMP] == 0:
        size = _SMALL_JUMP if cycle // _EVERY[_JUMP] % 2 else 1.0
        _birth(b, _JUMP, births.log_jump, watched, rate, births.jump_variance * size * size, 0.0)
    if cycle % _EVERY[_DRIFT] == 0:
        _birth(b, _DRIFT, births.log_drift, watched, rate, 0.0, births.drift_variance)
    if cycle % _EVERY[_END] == _EVERY[_END] // 2:
        best = _best(b.hypotheses)
        if b.p[rate, rate, best] > 0.0:
            _birth(b, _END, births.log_drift, watched, rate, 0.0, 0.0)


@compiled
def compare(b: BankArrays) -> None:
    """Weigh the hypotheses by this cycle's likelihoods, age them, normalize weights to the best, drop hopeless ones;
    mix the others."""
    hypotheses, shares, best_weight = b.hypotheses, b.shares, -1e300
    for i in range(len(hypotheses)):
        if hypotheses[i].alive != 0.0:
            hypotheses[i].weight += b.likelihoods[i]
            hypotheses[i].age += 1.0
            best_weight = max(best_weight, hypotheses[i].weight)
    total = 0.0
    for i in range(len(hypotheses)):
        shares[i] = 0.0
        if hypotheses[i].alive != 0.0:
            hypotheses[i].weight -= best_weight
            if hypotheses[i].weight < -_HOPELESS and hypotheses[i].age >= _PROTECTED[hypotheses[i].kind]:
                hypotheses[i].alive = 0.0
            else:
                shares[i] = exp(hypotheses[i].weight)
                total += shares[i]
    for i in range(len(hypotheses)):
        shares[i] /= total
    # Means and standard deviations of the mixture.
    for m in range(len(b.places)):
        j, mean, variance = b.places[m], 0.0, 0.0
        for i in range(len(shares)):
            mean += shares[i] * b.z[j, i]
        for i in range(len(shares)):
            variance += shares[i] * (b.p[j, j, i] + (b.z[j, i] - mean) ** 2)
        b.out[0, j], b.out[1, j] = mean, sqrt(max(variance, 0.0))


@compiled
def covariance(b: BankArrays, out: Array) -> None:
    """Covariance (n, n) of the mixture about its mean into `out`, after `compare`."""
    z, p, shares, mean, size = b.z, b.p, b.shares, b.out[0], b.z.shape[0]
    out[:] = 0.0
    for i in range(len(shares)):
        if shares[i] != 0.0:
            for j in range(size):
                for k in range(size):
                    out[j, k] += shares[i] * (p[j, k, i] + (z[j, i] - mean[j]) * (z[k, i] - mean[k]))
