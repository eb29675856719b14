"""Matched-filter detector of a sudden change of E at a carriage, by its tension transient.

Another E of the web at a dancer changes the tension at once, until the carriage has moved: it oscillates against the
web, and the torques of the neighbouring rollers with it. A slip at a roller, or entering web with another strain,
begins without that. The torques are compared with the transients of steps of several sizes, as a stiffer web oscillates
faster, orthogonal to other changes at the same instant: a constant load step at each roller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import MATRIX, VECTOR, entry_point
from hilbench.estimation.assumptions import CERTAIN

Vector = NDArray[np.float64]

#: Samples before the step in the comparison: they fix the initial torques.
BEFORE: Final = 10
#: Deviations of a certain transient, and of a possible one; share of the latter's explained squares, and deviations of
#: noise in addition to that, that may be left unexplained.
_STANDS_OUT = 5.5
_LEFT_SHARE, _LEFT_NOISE = 0.5, 2.0
#: Share of a transient's length after which the best fit is final: half a period earlier it looks like one of the
#: opposite sign.
_DECIDED: Final = 0.5
#: Error of a model's masses and friction: of the size that is found.
_OF_MODEL: Final = 0.1


@dataclass(frozen=True, slots=True)
class Transient:
    """Relative increase of E at a carriage, with standard deviation, so many cycles ago; not `sure`: noise may look
    like it."""

    share: float
    deviation: float
    cycles: int
    sure: bool


@entry_point(MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR)
def _take(
    values: Vector, torques: Vector, variances: Vector, transients: Vector, energies: Vector, products: Vector,
    sizes: Vector,
) -> None:  # fmt: skip
    """Shift a sample (m,) into `values` (cycles, m); correlate each transient (n, m·cycles), with `energies` (n, m),
    with them: `products` (n,) and `sizes` (n,), weighted by the variances (m,)."""
    cycles, m = values.shape
    for c in range(cycles - 1):
        for j in range(m):
            values[c, j] = values[c + 1, j]
    for j in range(m):
        values[cycles - 1, j] = torques[j]
    for i in range(len(products)):
        products[i] = sizes[i] = 0.0
        for j in range(m):
            product = 0.0
            for c in range(cycles):
                product += transients[i, j * cycles + c] * values[c, j]
            products[i] += product / variances[j]
            sizes[i] += energies[i, j] / variances[j]


class TransientDetector:
    """Matched filter. `transients` (n, M, m): response of each of m torques in M cycles from a step of E on, over its
    size; `shares` (n,): these sizes; `loads` (M, m): response to a load step at its own roller."""

    def __init__(self, transients: Vector, shares: Sequence[float], loads: Vector) -> None:
        count, cycles, torques = transients.shape
        self._cycles = BEFORE + cycles
        self._shares = np.array(shares)
        whole = np.concatenate([np.zeros((count, BEFORE, torques)), transients], axis=1)
        stepped = np.concatenate([np.zeros((BEFORE, torques)), loads])
        self._bases = [np.linalg.qr(np.stack([np.ones(self._cycles), each], axis=1))[0] for each in stepped.T]
        # Part of each transient orthogonal to offset and load step, (m, n, cycles).
        of_torques = np.stack([self._left(whole[:, :, at], at) for at in range(torques)])
        #: The same flattened, (n, m·cycles), and their energies (n, m).
        self._transients = np.ascontiguousarray(of_torques.transpose(1, 0, 2)).reshape(count, -1)
        self._energies = np.ascontiguousarray(np.sum(of_torques**2, axis=2).T)
        self._products, self._sizes = np.zeros(count), np.zeros(count)
        self.reset()

    def _left(self, values: Vector, torque: int) -> Vector:
        """Residual of values (…, cycles) after an offset and a load step."""
        basis = self._bases[torque]
        left: Vector = values - (values @ basis) @ basis.T
        return left

    def reset(self) -> None:
        """Forget all samples."""
        self._values = np.zeros((self._cycles, len(self._bases)))
        self._filled, self._best, self._since = 0, 0.0, 0
        self._found: Transient | None = None

    def take(self, torques_Nm: Vector, variances: Vector) -> Transient | None:
        """Take torque residuals (m,) to the simulated line, with their noise variances; returns a transient once it is
        decided."""
        self._filled += 1
        _take(self._values, torques_Nm, variances, self._transients, self._energies, self._products, self._sizes)
        if self._filled < self._cycles:
            return None
        products, sizes, weights = self._products, self._sizes, 1.0 / variances
        gains = products**2 / sizes
        at = int(np.argmax(gains))
        self._since += 1
        if gains[at] > max(self._best, CERTAIN**2):
            share = float(products[at] / sizes[at])
            self._best, self._since = float(gains[at]), 0
            deviation = hypot(1.0 / sqrt(float(sizes[at])), _OF_MODEL * share)
            sure = bool(gains[at] > _STANDS_OUT**2)
            self._found = Transient(share, deviation, 0, sure) if self._fits(float(gains[at]), weights) else None
        if self._best and self._found is None and self._since >= self._cycles:
            self._best = 0.0
        if self._found is None or self._since < _DECIDED * (self._cycles - BEFORE):
            return None
        found, since = self._found, self._since
        self.reset()
        return Transient(found.share, found.deviation, self._cycles - BEFORE + since, found.sure)

    def _fits(self, gain: float, weights: Vector) -> bool:
        """True if the transient explains most of the signal."""
        left = [self._left(values, torque) for torque, values in enumerate(self._values.T)]
        rest = sum(weight * float(each @ each) for weight, each in zip(weights.tolist(), left, strict=True)) - gain
        expected = len(weights) * self._cycles
        return bool(rest - expected < _LEFT_SHARE * gain + _LEFT_NOISE * sqrt(2.0 * expected))
