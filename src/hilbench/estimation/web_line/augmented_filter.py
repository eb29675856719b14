"""Kalman filter on corrections of a line's model (augmented state).

Innovations are linear in the unknowns (n,); their sensitivities come from the model. After each update the model is
corrected, so that the filter's own mean is 0, except for the measurement offsets (m,) and the model's parameters (p of
the unknowns). A parameter is the sum of two states: its error at the start, which is kept here as the measurements
never separate it for sure from their own slow errors, and its change since, which they do. What changes by itself does
so within its prior, as an Ornstein-Uhlenbeck process, or at an unknown rate (q of the unknowns) per travel of the web.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Vector
from hilbench.estimation.assumptions import CERTAIN

#: Normalized innovations beyond so many deviations, twice running, are no chance: a sudden change. The first of them is
#: not used: what has changed is not known, and small corrections of all would hide it. A gradual change is no sudden
#: one: at least this share was absent two innovations before. Then the limits of all innovations together.
_FAR_OFF, _SUDDEN = 6.0, 0.4
_SUDDEN_TOGETHER = 0.75
_TWICE = 2


@dataclass(frozen=True, slots=True)
class Posterior:
    """Covariance and mean of all states (n + p + q + m,)."""

    covariance: Vector
    mean: Vector


class AugmentedFilter:
    """Augmented-state Kalman filter with change detection.

    `start` (n, n): initial covariance; `parameters` (n,): which unknowns are parameters; `rates` (n,): deviations of
    their change per m, 0 without; `offsets` (m,): deviations of slow measurement errors; `transient_shares` (m,): share
    of a change's innovations that counts as measurement error of the transient, and `most_transient` (m,) of them;
    `transient_decay` (m,): share of that left per update; `transients` (m,): its initial deviation.
    """

    def __init__(
        self,
        start: Vector,
        parameters: NDArray[np.bool_],
        rates: Vector,
        offsets: Vector,
        transient_shares: Vector,
        most_transient: Vector,
        transient_decay: Vector,
        transients: Vector,
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
        #: State mean: unknowns, with the parameters as they were at the start; their changes; rates; offsets.
        self.mean = np.zeros(size)
        #: Unknowns as sums of states (n, n + p + q + m).
        self._sums = np.eye(n, size)
        self._sums[self.parameters, np.arange(n, self._first_rate)] = 1.0
        self._far_off = 0
        self._before = np.zeros((2, len(offsets)))  # innovations less the expected ones, the latest last
        #: True if the innovations were far off for the second time: a sudden change.
        self.has_changed = False
        self._transient_shares, self._most_transient = transient_shares, most_transient
        self._transient_decay, self._transients = transient_decay, transients

    @property
    def has_begun_to_change(self) -> bool:
        """True if the last innovations were far off for the first time; they were not used."""
        return self._far_off == 1

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the unknowns (n,)."""
        found: Vector = np.sqrt(np.diag(self._sums @ self.covariance @ self._sums.T))
        return found

    def deviation(self, unknown: int) -> float:
        """Standard deviation of one unknown, by index from 0."""
        row = self._sums[unknown]
        return sqrt(float(row @ self.covariance @ row))

    def expected(self, unknown: int) -> float:
        """Mean of one unknown, by index from 0."""
        return float(self._sums[unknown] @ self.mean)

    @property
    def posterior(self) -> Posterior:
        """Copy of covariance and mean, for `put_back`."""
        return Posterior(self.covariance.copy(), self.mean.copy())

    def of_unknowns(self, posterior: Posterior) -> tuple[Vector, Vector]:
        """Covariance (n, n) and mean (n,) of the unknowns."""
        return self._sums @ posterior.covariance @ self._sums.T, self._sums @ posterior.mean

    def take_changes(self, share: float) -> Vector:
        """Take a share of the estimated parameter changes out of the mean; returns the corrections (n,)."""
        return self._take(slice(self._count, self._first_rate), share)

    def take_start(self) -> Vector:
        """Take the parameters' estimated initial errors out of the mean; returns the corrections (n,)."""
        return self._take(self.parameters, 1.0)

    def give_back(self, taken: Vector) -> Vector:
        """Undo `take_start`: return what was `taken` (n,) to the mean; the corrections (n,) of the parameters."""
        self.mean[: self._count] += taken
        return -taken

    def _take(self, states: slice | NDArray[np.int64], share: float) -> Vector:
        corrections = np.zeros(self._count)
        corrections[self.parameters] = share * self.mean[states]
        self.mean[states] -= corrections[self.parameters]
        return corrections

    def evidence_of_change(self) -> float:
        """Squared Mahalanobis distance of the estimated parameter changes from 0."""
        return self._evidence(np.arange(self._count, self._first_rate))

    def evidence_of_start(self, taken: Vector) -> float:
        """Squared Mahalanobis distance of the parameters' initial errors from 0, including what was `taken` (n,)."""
        return self._evidence(self.parameters, taken[self.parameters])

    def _evidence(self, at: NDArray[np.int64], taken: Vector | float = 0.0) -> float:
        found = self.mean[at] + taken
        return float(found @ np.linalg.solve(self.covariance[np.ix_(at, at)], found)) if found.any() else 0.0

    def put_back(self, earlier: Posterior, taken: NDArray[np.bool_], variances: Vector) -> None:
        """Restore an earlier posterior for the offsets and the `taken` (n,) unknowns; the others get variances (n,)."""
        back = np.concatenate([self._of_states(taken), np.ones(len(self.mean) - self._first_rate, bool)])
        self.covariance = np.where(np.outer(back, back), earlier.covariance, 0.0)
        others = np.flatnonzero(~taken)
        self.covariance[others, others] = variances[others]
        self.mean = np.where(back, earlier.mean, 0.0)
        self._far_off = 0
        self._transients[:] = 0.0

    def _of_states(self, of_unknowns: Vector | NDArray[np.bool_]) -> Vector | NDArray[np.bool_]:
        """Stack rows of unknowns (n, …) and once more those of the parameters (p, …)."""
        return np.concatenate([of_unknowns, of_unknowns[self.parameters]])

    def grow(self, left: Vector, growth: Vector, travel_m: float) -> None:
        """Predict over a travel: `left` (n + p + q + m,) share of each state that remains, `growth` (n + p + q + m, n +
        p + q + m): covariance added."""
        continues = np.diag(left)
        continues[self._with_rate, np.arange(self._first_rate, self.first_offset)] = travel_m
        self.covariance = continues @ self.covariance @ continues.T + growth
        self.mean = continues @ self.mean

    def jump(self, jumps: Vector, becomes: Vector | None = None) -> None:
        """Add a sudden parameter change of covariance (p, p); `becomes` (n, n): sensitivity of other unknowns to it."""
        rows = self._by_change(becomes)
        self.covariance = self.covariance + rows @ jumps @ rows.T

    def _by_change(self, becomes: Vector | None) -> Vector:
        """Sensitivity of the states (n + p + q + m, p) to sudden parameter changes; see `jump`."""
        rows = np.zeros((len(self.mean), len(self.parameters)))
        if becomes is not None:
            rows[: self._count] = becomes[:, self.parameters]
        rows[self.parameters] = 0.0
        rows[self._count : self._first_rate] = np.eye(len(self.parameters))
        return rows

    def turn(self, matrix: Vector) -> None:
        """Change of basis of the unknowns: u ← matrix·u, `matrix` (n, n); parameters stay."""
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
        """Corrections of the unknowns (n,), 0 for parameters, from innovations (m,) with sensitivities `slopes` (m, n)
        and variances (m,).

        `jumps`: sudden change, see `jump`; `learns` (n, m): which unknown is updated by which innovation, offsets by
        none; the others are considered (Schmidt–Kalman). None: all are updated.
        """
        known = slopes @ self._sums
        known[:, self.first_offset :] = np.eye(len(innovations))
        left = innovations - known @ self.mean
        self._transients = self._transient_decay * self._transients
        variances = variances + self._transients**2
        spread = known @ self.covariance @ known.T + np.diag(variances)
        off = self._is_off(left, known, spread, jumps[1])
        self._far_off = self._far_off + 1 if off else 0
        self.has_changed = self._far_off == _TWICE
        if self.has_begun_to_change:
            return np.zeros(self._count)
        self._before = np.array([self._before[1], left])
        if self.has_changed:
            self.jump(*jumps)
            self._transients = np.minimum(self._transient_shares * np.abs(left), self._most_transient)
            variances = variances + self._transients**2
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
        """True if innovations (m,) with this covariance (m, m) are suddenly far off: one alone, or all together as if
        all parameters had changed by the same share."""
        deviations = np.sqrt(np.diag(spread))
        if np.any(_is_sudden(left / deviations, self._before[0] / deviations, _FAR_OFF, _SUDDEN)):
            return True
        change = np.linalg.solve(spread, known @ self._by_change(becomes).sum(axis=1))
        size = sqrt(float(change @ spread @ change))
        now, before = np.array([change @ left]), np.array([change @ self._before[0]])
        together = _is_sudden(now, before, CERTAIN * size, _SUDDEN_TOGETHER)
        return size > 0.0 and bool(together[0])


def _is_sudden(now: Vector, before: Vector, far_off: float, share: float) -> NDArray[np.bool_]:
    """True where values exceed `far_off` and at least this share of them was absent before."""
    sudden: NDArray[np.bool_] = (np.abs(now) > far_off) & (np.abs(now - before) > share * np.abs(now))
    return sudden
