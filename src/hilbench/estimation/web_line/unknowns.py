"""What is unknown of a line, from what it does: a Kalman filter on corrections of a model that is corrected with them.

Innovations are linear in the unknowns (n,) by slopes that the model tells of itself. After each update the model is
corrected, so that the filter's own mean is 0, but for the errors of the measurements (m,), which nobody else knows, and
for parameters of the model, which are corrected on overwhelming evidence alone: in between their mean is kept here, so
that nothing is learned from noise and no measurement counts twice. What changes by itself does so within its prior, as
an Ornstein-Uhlenbeck process.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

#: Innovations that are so many deviations off, twice running, are no chance: something has changed. Nothing is made of
#: the first of them: what has changed is not known, and small corrections of all would hide it. What has come gradually
#: is no sudden change: at least this share of it was not there two innovations before.
_FAR_OFF, _SUDDEN = 4.0, 0.5
_TWICE = 2


@dataclass(frozen=True, slots=True)
class Belief:
    """What was known once: covariance and mean of unknowns and offsets (n + m,)."""

    covariance: Vector
    mean: Vector


class Unknowns:
    """`start` (n, n): covariance of the unknowns at the start; `parameters` (n,): those whose mean is kept; `offsets`
    (m,): deviations of the slow errors of the measurements; `swings` (m,): of innovations by which a change is seen,
    how far each measurement may be off, as what is measured swings after it otherwise than the model says; `swings_on`:
    what is left of that an update later."""

    def __init__(
        self, start: Vector, parameters: NDArray[np.bool_], offsets: Vector, swings: Vector, swings_on: float
    ) -> None:
        self._count = len(start)
        size = self._count + len(offsets)
        self.covariance = np.zeros((size, size))
        self.covariance[: self._count, : self._count] = start
        self.covariance[self._count :, self._count :] = np.diag(offsets**2)
        #: Of unknowns and offsets: what they are beside what the model was corrected by.
        self.mean = np.zeros(size)
        self._parameters = np.flatnonzero(parameters)
        self._far_off = 0
        self._before = np.zeros((2, len(offsets)))  # innovations beside what was expected, the last one behind
        #: Whether the last innovations were far off again, and the unknowns have changed suddenly.
        self.has_changed = False
        self._swings, self._swings_on, self._swing = swings, swings_on, np.zeros(len(offsets))

    @property
    def has_begun_to_change(self) -> bool:
        """Whether the last innovations were far off for the first time, and nothing was made of them."""
        return self._far_off == 1

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the unknowns (n,)."""
        found: Vector = np.sqrt(np.diag(self.covariance)[: self._count])
        return found

    def deviation(self, unknown: int) -> float:
        """Of one of them, from 0."""
        return sqrt(self.covariance.item(unknown, unknown))

    @property
    def belief(self) -> Belief:
        """What is known now, for `put_back`."""
        return Belief(self.covariance.copy(), self.mean.copy())

    def evidence(self, errors: Vector) -> float:
        """Against it that the parameters are without these errors, of the unknowns (n,): their squared distance from 0
        in standard deviations."""
        at = self._parameters
        known = self.covariance[np.ix_(at, at)]
        return float(errors[at] @ np.linalg.solve(known, errors[at])) if errors[at].any() else 0.0

    def take_parameters(self, left: Vector) -> Vector:
        """Corrections (n,) by the mean of the parameters, of which so much is `left` (n,)."""
        taken = np.zeros(self._count)
        taken[self._parameters] = (self.mean[: self._count] - left)[self._parameters]
        self.mean[: self._count] -= taken
        return taken

    def put_back(self, earlier: Belief, taken: NDArray[np.bool_], variances: Vector) -> None:
        """Of the offsets, and of the unknowns that are `taken` (n,), is known what was known earlier, no more and no
        less; of the others these variances (n,)."""
        back = np.concatenate([taken, np.ones(len(self.mean) - self._count, bool)])
        self.covariance = np.where(np.outer(back, back), earlier.covariance, 0.0)
        others = np.flatnonzero(~taken)
        self.covariance[others, others] = variances[others]
        self.mean = np.where(back, earlier.mean, 0.0)
        self._far_off = 0
        self._swing[:] = 0.0

    def grow(self, left: Vector, growth: Vector) -> None:
        """Time goes by: of what is known of unknowns and offsets so much is `left` (n + m,), as shares, and what they
        may have changed by has this covariance (n + m, n + m)."""
        self.covariance = left[:, None] * self.covariance * left + growth
        self.mean = left * self.mean

    def jump(self, jumps: Vector) -> None:
        """The unknowns have changed by something of this covariance (n, n)."""
        self.covariance[: self._count, : self._count] += jumps

    def reopen(self) -> None:
        """The parameters are others than believed, by about their mean: it is that much less certain, and so is what
        depends on them."""
        at, mean = self._parameters, self.mean[self._parameters]
        known = self.covariance[np.ix_(at, at)]
        change = np.linalg.solve(known, self.covariance[at]).T @ mean
        self.covariance = self.covariance + np.outer(change, change)

    def turn(self, matrix: Vector) -> None:
        """The unknowns are others now, `matrix` (n, n) times those of before."""
        whole = np.eye(len(self.covariance))
        whole[: self._count, : self._count] = matrix
        self.covariance = whole @ self.covariance @ whole.T
        self.mean = whole @ self.mean

    def update(
        self,
        innovations: Vector,
        slopes: Vector,
        variances: Vector,
        jumps: Vector,
        learns: NDArray[np.bool_] | None = None,
    ) -> Vector:
        """Corrections of the unknowns (n,), of the parameters none, by innovations (m,) with slopes (m, n) and
        variances (m,); `jumps` (n, n): covariance of a sudden change of the unknowns; `learns` (n, m): which unknown is
        learned from which innovation, and no offset from any then: how little is known of the rest is reckoned with
        all the same. None: all."""
        known = np.hstack([slopes, np.eye(len(innovations))])
        left = innovations - known @ self.mean
        self._swing = self._swings_on * self._swing
        variances = variances + self._swing**2
        spread = known @ self.covariance @ known.T + np.diag(variances)
        sudden = np.abs(left - self._before[0]) > _SUDDEN * np.abs(left)
        off = bool(np.any(sudden & (np.abs(left) > _FAR_OFF * np.sqrt(np.diag(spread)))))
        self._far_off = self._far_off + 1 if off else 0
        self.has_changed = self._far_off == _TWICE
        if self.has_begun_to_change:
            return np.zeros(self._count)
        self._before = np.array([self._before[1], left])
        if self.has_changed:
            self.jump(jumps)
            self._swing = self._swings * np.abs(left)
            variances = variances + self._swing**2
            spread = known @ self.covariance @ known.T + np.diag(variances)
            self._far_off = 0
        gain = np.linalg.solve(spread, known @ self.covariance).T
        if learns is not None:
            gain = gain * np.vstack([learns, np.zeros((len(left), len(left)), bool)])
        rest = np.eye(len(self.covariance)) - gain @ known
        self.covariance = rest @ self.covariance @ rest.T + (gain * variances) @ gain.T
        self.mean = self.mean + gain @ left
        changes = self.mean[: self._count].copy()
        changes[self._parameters] = 0.0
        self.mean[: self._count] -= changes
        return changes
