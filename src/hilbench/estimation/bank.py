"""Bank of Kalman filters, one for each hypothesis of when a parameter last jumped or began to drift.

They are mixed by evidence: Bayesian change-point detection (Adams and MacKay 2007) with a Kalman filter as the model of
a run, so that a hypothesis is weighed by its prediction of the next encoder position. Each young hypothesis is kept for
a while, whatever its weight, so that a small change has time to show; after that the least probable ones are dropped.
Between changes the mixture is one long-run filter with little noise; at a change the right hypothesis already exists,
and takes over as soon as the data prefer it. The deviation is that of the mixture: it is wide while it is undecided.

Three kinds of child are born of the most probable hypothesis: a *jump* of the watched parameter (large and small in
turn), a *drift* (a rate of it), and, of a drift, its *end*.

Means (n, H) and covariances (n, n, H) of all hypotheses are columns, with a record (H, RECORD) of each. The bank is
independent of the kind of filter: a cycle is a step of all filters, whose log likelihoods are added to their weights
(`reweight`), then `compare`, `mix` and `births`. Dropped filters are stepped with the others.
"""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled

Array = NDArray[np.float64]
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

# Columns of the hypotheses' records.
WEIGHT, _KIND, _AGE, ALIVE = range(4)
RECORD = 4
# Settings of births: priors (logarithms), variances of a jump and of a drift's rate, and the cycle's number.
LOG_JUMP, LOG_DRIFT, JUMP_VARIANCE, DRIFT_VARIANCE, CYCLE = range(5)
SETTINGS = 5


def set_priors(settings: Array, jumps_per_s: float, drift_onsets_per_s: float, cycle_s: float) -> None:
    """Set the prior of one birth from the rates of jumps and of drift onsets."""
    settings[LOG_JUMP] = log(jumps_per_s * _EVERY[_JUMP] * cycle_s)
    settings[LOG_DRIFT] = log(drift_onsets_per_s * _EVERY[_DRIFT] * cycle_s)


@compiled
def _free_place(records: Array) -> int:
    """Index of a hypothesis that may be replaced; -1: all are needed."""
    worst = -1
    for i in range(records.shape[0]):
        if records[i, ALIVE] == 0.0:
            return i
        of_age = records[i, _AGE] >= _PROTECTED[int(records[i, _KIND])]
        if of_age and (worst < 0 or records[i, WEIGHT] < records[worst, WEIGHT]):
            worst = i
    return worst


@compiled
def _best(records: Array) -> int:
    best = -1
    for i in range(records.shape[0]):
        if records[i, ALIVE] != 0.0 and (best < 0 or records[i, WEIGHT] > records[best, WEIGHT]):
            best = i
    return best


@compiled
def _birth(
    z: Array,
    p: Array,
    records: Array,
    kind: int,
    log_prior: float,
    watched: int,
    rate: int,
    variance: float,
    rate_variance: float,
) -> None:
    """Add a child of the best hypothesis, with these variances added to the watched parameter and set for its rate."""
    parent = _best(records)
    i = _free_place(records)
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
    records[i, WEIGHT] = records[parent, WEIGHT] + log_prior
    records[i, _KIND] = kind
    records[i, _AGE] = 0.0
    records[i, ALIVE] = 1.0


@compiled
def births(z: Array, p: Array, records: Array, settings: Array, watched: int, rate: int) -> None:
    """Add the children of this cycle; `watched` and `rate` are indices in the filters' state."""
    cycle = int(settings[CYCLE])
    if cycle % _EVERY[_JUMP] == 0:
        size = _SMALL_JUMP if cycle // _EVERY[_JUMP] % 2 else 1.0
        _birth(z, p, records, _JUMP, settings[LOG_JUMP], watched, rate, settings[JUMP_VARIANCE] * size * size, 0.0)
    if cycle % _EVERY[_DRIFT] == 0:
        _birth(z, p, records, _DRIFT, settings[LOG_DRIFT], watched, rate, 0.0, settings[DRIFT_VARIANCE])
    if cycle % _EVERY[_END] == _EVERY[_END] // 2:
        best = _best(records)
        if p[rate, rate, best] > 0.0:
            _birth(z, p, records, _END, settings[LOG_DRIFT], watched, rate, 0.0, 0.0)


@compiled
def reweight(records: Array, likelihoods: Array) -> None:
    """Add the log likelihoods (H,) of this cycle to the weights."""
    for i in range(records.shape[0]):
        if records[i, ALIVE] != 0.0:
            records[i, WEIGHT] += likelihoods[i]


@compiled
def compare(records: Array, shares: Array) -> None:
    """Age the hypotheses, normalize weights to the best and drop hopeless ones. Shares (H,) returns the probabilities,
    0 of dropped ones."""
    best_weight = -1e300
    for i in range(records.shape[0]):
        if records[i, ALIVE] != 0.0:
            records[i, _AGE] += 1.0
            best_weight = max(best_weight, records[i, WEIGHT])
    total = 0.0
    for i in range(records.shape[0]):
        shares[i] = 0.0
        if records[i, ALIVE] != 0.0:
            records[i, WEIGHT] -= best_weight
            if records[i, WEIGHT] < -_HOPELESS and records[i, _AGE] >= _PROTECTED[int(records[i, _KIND])]:
                records[i, ALIVE] = 0.0
            else:
                shares[i] = exp(records[i, WEIGHT])
                total += shares[i]
    for i in range(records.shape[0]):
        shares[i] /= total


@compiled
def covariance(z: Array, p: Array, shares: Array, mean: Array, out: Array) -> None:
    """Covariance (n, n) of the mixture about its mean into `out`; shares as of `compare`."""
    size = z.shape[0]
    out[:] = 0.0
    for i in range(len(shares)):
        if shares[i] != 0.0:
            for j in range(size):
                for k in range(size):
                    out[j, k] += shares[i] * (p[j, k, i] + (z[j, i] - mean[j]) * (z[k, i] - mean[k]))


@compiled
def mix(z: Array, p: Array, shares: Array, places: Places, out: Array) -> None:
    """Means and standard deviations of the mixture into the first two rows of `out`; shares as of `compare`, places:
    indices of the filters' states."""
    for m in range(len(places)):
        j, mean, variance = places[m], 0.0, 0.0
        for i in range(len(shares)):
            mean += shares[i] * z[j, i]
        for i in range(len(shares)):
            variance += shares[i] * (p[j, j, i] + (z[j, i] - mean) ** 2)
        out[0, j], out[1, j] = mean, sqrt(max(variance, 0.0))
