"""What is unknown of a line, from what it does: a Kalman filter on corrections of a model that is corrected with them.

Innovations are linear in the unknowns (n,) by slopes that the model tells of itself. After each update the model is
corrected, so that the filter's own mean is 0, but for the errors of the measurements (m,), which nobody else knows, and
for parameters of the model (p of the unknowns). A parameter is the sum of two states: what the model may have been
wrong by from the start, which is kept here as the measurements never tell it apart from their own slow errors for sure,
and by what it has changed since, which they do. What changes by itself does so within its prior, as an
Ornstein-Uhlenbeck process, or at an unknown rate (q of the unknowns) with the way of the web.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

#: Innovations that are so many deviations off, twice running, are no chance: something has changed. Nothing is made of
#: the first of them: what has changed is not known, and small corrections of all would hide it. What has come gradually
#: is no sudden change: at least this share of it was not there two innovations before. Then the same of all together.
_FAR_OFF, _SUDDEN = 6.0, 0.4
_FAR_OFF_TOGETHER, _SUDDEN_TOGETHER = 4.0, 0.75
_TWICE = 2


@dataclass(frozen=True, slots=True)
class Posterior:
    """What was known once of all states (n + p + q + m,): covariance and mean."""

    covariance: Vector
    mean: Vector


class AugmentedFilter:
    """`start` (n, n): covariance of the unknowns at the start; `parameters` (n,): those that are parameters; `rates`
    (n,): deviations of what they change by per m, 0 of those that have no such rate; `offsets` (m,): deviations of the
    slow errors of the measurements; `swings` (m,): of innovations by which a change is seen, how far each measurement
    may be off, as what is measured swings after it otherwise than the model says; `swings_on` (m,): what is left of
    that an update later; `swinging` (m,): how far off they may be so at first."""

    def __init__(
        self,
        start: Vector,
        parameters: NDArray[np.bool_],
        rates: Vector,
        offsets: Vector,
        swings: Vector,
        swings_on: Vector,
        swinging: Vector,
    ) -> None:
        self._count = n = len(start)
        self.parameters, self._with_rate = np.flatnonzero(parameters), np.flatnonzero(rates)
        self._first_rate = n + len(self.parameters)
        self.first_offset = self._first_rate + len(self._with_rate)
        size = self.first_offset + len(offsets)
        self.covariance = np.zeros((size, size))
        self.covariance[:n, :n] = start
        constant = np.concatenate([rates[self._with_rate], offsets])
        self.covariance[self._first_rate :, self._first_rate :] = np.diag(constant**2)
        #: Of the states: unknowns, with the parameters as they were at the start, changes of these, rates, offsets.
        self.mean = np.zeros(size)
        #: The unknowns by the states (n, n + p + q + m).
        self._sums = np.eye(n, size)
        self._sums[self.parameters, np.arange(n, self._first_rate)] = 1.0
        self._far_off = 0
        self._before = np.zeros((2, len(offsets)))  # innovations beside what was expected, the last one behind
        #: Whether the last innovations were far off again, and the unknowns have changed suddenly.
        self.has_changed = False
        self._swings, self._swings_on, self._swing = swings, swings_on, swinging

    @property
    def has_begun_to_change(self) -> bool:
        """Whether the last innovations were far off for the first time, and nothing was made of them."""
        return self._far_off == 1

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the unknowns (n,)."""
        found: Vector = np.sqrt(np.diag(self._sums @ self.covariance @ self._sums.T))
        return found

    def deviation(self, unknown: int) -> float:
        """Of one of them, from 0."""
        row = self._sums[unknown]
        return sqrt(float(row @ self.covariance @ row))

    def expected(self, unknown: int) -> float:
        """Mean of one of them, from 0."""
        return float(self._sums[unknown] @ self.mean)

    @property
    def posterior(self) -> Posterior:
        """What is known now, for `put_back`."""
        return Posterior(self.covariance.copy(), self.mean.copy())

    def of_unknowns(self, posterior: Posterior) -> tuple[Vector, Vector]:
        """Covariance (n, n) and mean (n,) of the unknowns."""
        return self._sums @ posterior.covariance @ self._sums.T, self._sums @ posterior.mean

    def take_changes(self, share: float) -> Vector:
        """Corrections (n,) by so much of the changes of the parameters."""
        return self._take(slice(self._count, self._first_rate), share)

    def take_start(self) -> Vector:
        """Corrections (n,) by what the parameters were wrong by from the start."""
        return self._take(self.parameters, 1.0)

    def give_back(self, taken: Vector) -> Vector:
        """Corrections (n,) by which the parameters are without what was `taken` (n,) of what they were wrong by from
        the start."""
        self.mean[: self._count] += taken
        return -taken

    def _take(self, states: slice | NDArray[np.int64], share: float) -> Vector:
        corrections = np.zeros(self._count)
        corrections[self.parameters] = share * self.mean[states]
        self.mean[states] -= corrections[self.parameters]
        return corrections

    def evidence_of_change(self) -> float:
        """Against it that the parameters are without what is found of their changes: its squared distance from 0 in
        standard deviations."""
        return self._evidence(np.arange(self._count, self._first_rate))

    def evidence_of_start(self, taken: Vector) -> float:
        """The same of what they were wrong by from the start, with what was `taken` (n,) of it."""
        return self._evidence(self.parameters, taken[self.parameters])

    def _evidence(self, at: NDArray[np.int64], taken: Vector | float = 0.0) -> float:
        found = self.mean[at] + taken
        return float(found @ np.linalg.solve(self.covariance[np.ix_(at, at)], found)) if found.any() else 0.0

    def put_back(self, earlier: Posterior, taken: NDArray[np.bool_], variances: Vector) -> None:
        """Of the offsets, and of the unknowns that are `taken` (n,), is known what was known earlier, no more and no
        less; of the others these variances (n,)."""
        back = np.concatenate([self._of_states(taken), np.ones(len(self.mean) - self._first_rate, bool)])
        self.covariance = np.where(np.outer(back, back), earlier.covariance, 0.0)
        others = np.flatnonzero(~taken)
        self.covariance[others, others] = variances[others]
        self.mean = np.where(back, earlier.mean, 0.0)
        self._far_off = 0
        self._swing[:] = 0.0

    def _of_states(self, of_unknowns: Vector | NDArray[np.bool_]) -> Vector | NDArray[np.bool_]:
        """Rows of unknowns (n, …), and behind them those of the parameters (p, …) once more."""
        return np.concatenate([of_unknowns, of_unknowns[self.parameters]])

    def grow(self, left: Vector, growth: Vector, travel_m: float) -> None:
        """Time goes by, and so much web: of what is known of the states so much is `left` (n + p + q + m,), as shares,
        and what they may have changed by has this covariance (n + p + q + m, n + p + q + m)."""
        continues = np.diag(left)
        continues[self._with_rate, np.arange(self._first_rate, self.first_offset)] = travel_m
        self.covariance = continues @ self.covariance @ continues.T + growth
        self.mean = continues @ self.mean

    def jump(self, jumps: Vector, becomes: Vector | None = None) -> None:
        """The parameters have changed suddenly by something of this covariance (p, p); `becomes` (n, n): what other
        unknowns become by that. None: nothing."""
        rows = self._by_change(becomes)
        self.covariance = self.covariance + rows @ jumps @ rows.T

    def _by_change(self, becomes: Vector | None) -> Vector:
        """What the states are other by (n + p + q + m, p) as parameters change suddenly; see `jump`."""
        rows = np.zeros((len(self.mean), len(self.parameters)))
        if becomes is not None:
            rows[: self._count] = becomes[:, self.parameters]
        rows[self.parameters] = 0.0
        rows[self._count : self._first_rate] = np.eye(len(self.parameters))
        return rows

    def turn(self, matrix: Vector) -> None:
        """The unknowns are others now, `matrix` (n, n) times those of before."""
        whole = np.eye(len(self.covariance))
        whole[: self._count, : self._count] = matrix
        changed = matrix[:, self.parameters].copy()
        changed[self.parameters] = 0.0  # parameters stay what they are
        whole[: self._count, self._count : self._first_rate] = changed
        self.covariance = whole @ self.covariance @ whole.T
        self.mean = whole @ self.mean

    def update(
        self,
        innovations: Vector,
        slopes: Vector,
        variances: Vector,
        jumps: tuple[Vector, Vector],
        learns: NDArray[np.bool_] | None = None,
    ) -> Vector:
        """Corrections of the unknowns (n,), of the parameters none, by innovations (m,) with slopes (m, n) and
        variances (m,); `jumps`: of a sudden change, see `jump`; `learns` (n, m): which unknown is learned from which
        innovation, and no offset from any then: how little is known of the rest is reckoned with all the same. None:
        all."""
        known = slopes @ self._sums
        known[:, self.first_offset :] = np.eye(len(innovations))
        left = innovations - known @ self.mean
        self._swing = self._swings_on * self._swing
        variances = variances + self._swing**2
        spread = known @ self.covariance @ known.T + np.diag(variances)
        off = self._is_off(left, known, spread, jumps[1])
        self._far_off = self._far_off + 1 if off else 0
        self.has_changed = self._far_off == _TWICE
        if self.has_begun_to_change:
            return np.zeros(self._count)
        self._before = np.array([self._before[1], left])
        if self.has_changed:
            self.jump(*jumps)
            self._swing = self._swings * np.abs(left)
            variances = variances + self._swing**2
            spread = known @ self.covariance @ known.T + np.diag(variances)
            self._far_off = 0
        gain = np.linalg.solve(spread, known @ self.covariance).T
        if learns is not None:
            gain = gain * np.vstack(
                [self._of_states(learns), np.zeros((len(self.mean) - self._first_rate, len(left)), bool)]
            )
        rest = np.eye(len(self.covariance)) - gain @ known
        self.covariance = rest @ self.covariance @ rest.T + (gain * variances) @ gain.T
        self.mean = self.mean + gain @ left
        changes = self.mean[: self._count].copy()
        changes[self.parameters] = 0.0
        self.mean[: self._count] -= changes
        return changes

    def _is_off(self, left: Vector, known: Vector, spread: Vector, becomes: Vector) -> bool:
        """Whether innovations (m,) of this covariance (m, m) are suddenly far off: one of them, or all together as
        where all parameters have changed by the same share."""
        deviations = np.sqrt(np.diag(spread))
        if np.any(_is_sudden(left / deviations, self._before[0] / deviations, _FAR_OFF, _SUDDEN)):
            return True
        change = np.linalg.solve(spread, known @ self._by_change(becomes).sum(axis=1))
        size = sqrt(float(change @ spread @ change))
        now, before = np.array([change @ left]), np.array([change @ self._before[0]])
        together = _is_sudden(now, before, _FAR_OFF_TOGETHER * size, _SUDDEN_TOGETHER)
        return size > 0.0 and bool(together[0])


def _is_sudden(now: Vector, before: Vector, far_off: float, share: float) -> NDArray[np.bool_]:
    """Whether values are so far off, and at least this share of them was not there before."""
    sudden: NDArray[np.bool_] = (np.abs(now) > far_off) & (np.abs(now - before) > share * np.abs(now))
    return sudden
