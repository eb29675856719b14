"""Evidence for unmodelled effects, from the posterior of one filter that contains all of them; compiled.

A filter whose states θ have the prior N(0, P0) and the posterior N(m, P) holds all information of the data on θ: Λ =
P⁻¹ − P0⁻¹ and η = P⁻¹·m. So the evidence of any other prior N(0, D) follows without another filter (the density ratio
of Dickey 1971, for a spike that is no point):

    log p(y | D) = −½·log|Λ + D⁻¹| − ½·log|D| + ½·η'·(Λ + D⁻¹)⁻¹·η

D has the usual variance for a group that is lacking, and a hundredth of it for one that the model has right: no model
is surer than that. A set of groups is accepted in place of another when it is more probable by a factor that noise
reaches once in a hundred hours; it is given up by the same rule. Its mean is that under its prior.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Any, Final

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import compiled

#: Largest number of states that are compared.
SIZE: Final = 13
GROUPS: Final = 6
_SETS: Final = 2**GROUPS
EVIDENCE = np.dtype(
    [
        ("count", "i8"),  # of states that are compared
        ("places", "i8", (SIZE,)),  # indices in the filter
        ("groups", "i8", (SIZE,)),  # group of each
        ("least", "f8", (SIZE,)),  # least possible value of each, in usual deviations
        ("accepted", "i8"),  # set of groups, a bit each
        ("lacking", "f8"),  # probability that the model lacks anything
        ("information", "f8", (SIZE, SIZE)),
        ("weighed", "f8", (SIZE,)),
        ("factor", "f8", (SIZE, SIZE)),
        ("mean", "f8", (SIZE,)),
        ("scores", "f8", (_SETS,)),
    ]
)
#: Prior probability that the model lacks a group.
LACKING: Final = 0.1
#: Variance of an effect that the model has right, over its usual one.
_SPIKE: Final = 0.01
#: Logarithm of the odds from which on another set is accepted. By the inequality of Ville (1939) noise alone reaches
#: odds of 1 to exp(-12) with a probability of 6e-6 however long one looks.
_OVERWHELMING: Final = 7.0


@compiled
def _factorize(a: Array, n: int, out: Array) -> float:
    """Cholesky factor of a (n, n) into the lower half of `out`; returns the log determinant, or 1e300 if not positive
    definite."""
    total = 0.0
    for i in range(n):
        for j in range(i + 1):
            value = a[i, j]
            for k in range(j):
                value -= out[i, k] * out[j, k]
            if i == j:
                if value <= 0.0:
                    return 1e300
                out[i, i] = sqrt(value)
                total += log(value)
            else:
                out[i, j] = value / out[j, j]
    return total


@compiled
def _solve(factor: Array, n: int, b: Array) -> None:
    """Solve in place, b (n,), by a Cholesky factor."""
    for i in range(n):
        for k in range(i):
            b[i] -= factor[i, k] * b[k]
        b[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= factor[k, i] * b[k]
        b[i] /= factor[i, i]


@compiled
def _gather(s: Any, x: Array, covariance: Array, prior: Array, wander: Array) -> bool:
    """Information of the data on the states, in units of their usual deviations; False if there is none."""
    n = s.count
    for i in range(n):
        at = s.places[i]
        for j in range(i + 1):
            to = s.places[j]
            s.information[i, j] = covariance[at, to] / sqrt(prior[at] * prior[to])
    if _factorize(s.information, n, s.factor) >= 1e300:
        return False
    for i in range(n):
        s.weighed[i] = x[s.places[i]] / sqrt(prior[s.places[i]])
    _solve(s.factor, n, s.weighed)
    for i in range(n):
        for j in range(n):
            s.mean[j] = 1.0 if i == j else 0.0
        _solve(s.factor, n, s.mean)
        for j in range(n):
            s.information[i, j] = s.mean[j]
    for i in range(n):
        s.information[i, i] -= 1.0 / (1.0 + wander[s.places[i]])
    return True


@compiled
def _score(s: Any, chosen: int) -> float:
    """Log probability of a set of groups, up to a constant; fills `mean` with the states' mean under it."""
    n, total = s.count, 0.0
    for i in range(n):
        s.mean[i] = s.weighed[i]
        if not chosen >> s.groups[i] & 1:
            total -= 0.5 * log(_SPIKE)
        s.information[i, i] += 1.0 if chosen >> s.groups[i] & 1 else 1.0 / _SPIKE
    determinant = _factorize(s.information, n, s.factor)
    for i in range(n):
        s.information[i, i] -= 1.0 if chosen >> s.groups[i] & 1 else 1.0 / _SPIKE
    if determinant >= 1e300:
        return -1e300
    _solve(s.factor, n, s.mean)
    for i in range(n):
        total += 0.5 * s.weighed[i] * s.mean[i]
        if s.mean[i] < s.least[i] and chosen >> s.groups[i] & 1:
            return -1e300
    for group in range(GROUPS):
        total += log(LACKING) if chosen >> group & 1 else log(1.0 - LACKING)
    return float(total - 0.5 * determinant)


@compiled
def look(s: Any, x: Array, covariance: Array, prior: Array, wander: Array, target: Array) -> None:
    """Compare all sets of groups by the filter's posterior.

    Mean x (N,), covariance (N, N), prior variances (N,), random-walk variances relative to those (N,); target (N,):
    mean of the accepted set.
    """
    if not _gather(s, x, covariance, prior, wander):
        return
    best, none = 0, 0
    for chosen in range(_SETS):
        s.scores[chosen] = _score(s, chosen)
        if s.scores[chosen] > s.scores[best]:
            best = chosen
    if s.scores[best] - s.scores[s.accepted] > _OVERWHELMING:
        s.accepted = best
    total = 0.0
    for chosen in range(_SETS):
        total += exp(s.scores[chosen] - s.scores[best])
    s.lacking = 1.0 - exp(s.scores[none] - s.scores[best]) / total
    _score(s, s.accepted)
    for i in range(s.count):
        at = s.places[i]
        target[at] = s.mean[i] * sqrt(prior[at]) if s.accepted >> s.groups[i] & 1 else 0.0
