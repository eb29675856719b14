"""What is unknown of a line, from what it does: a Kalman filter on corrections of a model that is corrected with them.

Innovations are linear in the unknowns (n,) by slopes that the model tells of itself. After each update the model is
corrected, so that the filter's own mean is always 0, but for the constant errors of the measurements (m,), which
nobody else knows.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

#: Innovations that are so many deviations off, twice running, are no chance: something has changed. Nothing is made of
#: the first of them: what has changed is not known, and small corrections of all would hide it.
_FAR_OFF = 5.0
_TWICE = 2


@dataclass(frozen=True, slots=True)
class Belief:
    """What was known once: covariance of unknowns and offsets, and the offsets (m,)."""

    covariance: Vector
    offsets: Vector


class Unknowns:
    """`start` (n, n): covariance of the unknowns at the start; `offsets` (m,): deviations of the constant errors of the
    measurements; `swings` (m,): of innovations by which a change is seen, how far each measurement may be off, as what
    is measured swings after it otherwise than the model says; `swings_on`: what is left of that an update later."""

    def __init__(self, start: Vector, offsets: Vector, swings: Vector, swings_on: float) -> None:
        self._count = len(start)
        size = self._count + len(offsets)
        self.covariance = np.zeros((size, size))
        self.covariance[: self._count, : self._count] = start
        self.covariance[self._count :, self._count :] = np.diag(offsets**2)
        self._offsets = np.zeros(len(offsets))
        self._far_off = 0
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
        return Belief(self.covariance.copy(), self._offsets.copy())

    def put_back(self, earlier: Belief, taken: NDArray[np.bool_], variances: Vector) -> None:
        """Of the offsets, and of the unknowns that are `taken` (n,), is known what was known earlier, no more and no
        less; of the others these variances (n,)."""
        back = np.concatenate([taken, np.ones(len(self._offsets), bool)])
        self.covariance = np.where(np.outer(back, back), earlier.covariance, 0.0)
        others = np.flatnonzero(~taken)
        self.covariance[others, others] = variances[others]
        self._offsets = earlier.offsets.copy()
        self._far_off = 0
        self._swing[:] = 0.0

    def grow(self, variances: Vector, of_offsets: Vector) -> None:
        """What unknowns (n,) and offsets (m,) may have changed by in the meantime, as variances."""
        places = np.arange(len(self.covariance))
        self.covariance[places, places] += np.concatenate([variances, of_offsets])

    def jump(self, jumps: Vector) -> None:
        """The unknowns have changed by something of this covariance (n, n)."""
        self.covariance[: self._count, : self._count] += jumps

    def turn(self, matrix: Vector) -> None:
        """The unknowns are others now, `matrix` (n, n) times those of before."""
        whole = np.eye(len(self.covariance))
        whole[: self._count, : self._count] = matrix
        self.covariance = whole @ self.covariance @ whole.T

    def update(
        self,
        innovations: Vector,
        slopes: Vector,
        variances: Vector,
        jumps: Vector,
        learns: NDArray[np.bool_] | None = None,
    ) -> Vector:
        """Changes of the unknowns (n,) by innovations (m,) with slopes (m, n) and variances (m,); `jumps` (n, n):
        covariance of a sudden change of the unknowns; `learns` (n, m): which unknown is learned from which innovation,
        and no offset from any then: how little is known of the rest is reckoned with all the same. None: all."""
        known = np.hstack([slopes, np.eye(len(innovations))])
        left = innovations - self._offsets
        self._swing = self._swings_on * self._swing
        variances = variances + self._swing**2
        spread = known @ self.covariance @ known.T + np.diag(variances)
        off = bool(np.any(np.abs(left) > _FAR_OFF * np.sqrt(np.diag(spread))))
        self._far_off = self._far_off + 1 if off else 0
        if self.has_begun_to_change:
            return np.zeros(self._count)
        if self._far_off == _TWICE:
            self.jump(jumps)
            self._swing = self._swings * np.abs(left)
            variances = variances + self._swing**2
            spread = known @ self.covariance @ known.T + np.diag(variances)
            self._far_off = 0
        gain = np.linalg.solve(spread, known @ self.covariance).T
        if learns is not None:
            gain = gain * np.vstack([learns, np.zeros((len(left), len(left)), bool)])
        changes: Vector = gain @ left
        rest = np.eye(len(self.covariance)) - gain @ known
        self.covariance = rest @ self.covariance @ rest.T + (gain * variances) @ gain.T
        self._offsets += changes[self._count :]
        return changes[: self._count]
