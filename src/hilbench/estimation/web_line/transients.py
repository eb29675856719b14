"""A sudden change of the web whose tension a carriage keeps, by the kick that it gives.

Another E of the web beside a dancer is another tension at once, until the carriage has given way: it swings against
the web, and the torques of the rollers beside it with it. A slip at a roller, or web that comes in with another strain,
begins without that. What the torques do is compared with what they would do after steps of several sizes, as a stiffer
web swings faster, beside all that begins at the same instant otherwise: at each roller another constant load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import MATRIX, VECTOR, entry_point

Vector = NDArray[np.float64]

#: Samples before the step in what is compared: they say from where the torques set out.
BEFORE: Final = 10
#: Deviations by which a kick stands out that is one, and one that may be; of what the latter explains the share, and
#: beside that deviations of the noise, that may be left unexplained with it.
_STANDS_OUT, _MAY_BE = 5.5, 4.0
_LEFT_SHARE, _LEFT_NOISE = 0.5, 2.0
#: Share of the length of a kick after which the best fit is no more surpassed: half a swing earlier it looks like one
#: the other way.
_DECIDED: Final = 0.5
#: Error of a model's masses and friction: of the size that is found.
_OF_MODEL: Final = 0.1


@dataclass(frozen=True, slots=True)
class Transient:
    """E of the web beside a carriage is so much larger, as a share, with a standard deviation, since so many cycles;
    not `sure`: noise may look like it."""

    share: float
    deviation: float
    cycles: int
    sure: bool


@entry_point(MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR)
def _take(
    values: Vector, torques: Vector, variances: Vector, transients: Vector, energies: Vector, products: Vector,
    sizes: Vector,
) -> None:  # fmt: skip
    """Another sample (m,) behind `values` (cycles, m), without the first; each of the kicks (n, m·cycles), in which
    are `energies` (n, m), with that: `products` (n,) and `sizes` (n,), weighted by the variances (m,)."""
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
    """`transients` (n, M, m): what each of m torques does in M cycles from a step of E on, over its size;
    `shares` (n,): these sizes; `loads` (M, m): what it does from a step of the load at its own roller on."""

    def __init__(self, transients: Vector, shares: Sequence[float], loads: Vector) -> None:
        count, cycles, torques = transients.shape
        self._cycles = BEFORE + cycles
        self._shares = np.array(shares)
        whole = np.concatenate([np.zeros((count, BEFORE, torques)), transients], axis=1)
        stepped = np.concatenate([np.zeros((BEFORE, torques)), loads])
        self._bases = [np.linalg.qr(np.stack([np.ones(self._cycles), each], axis=1))[0] for each in stepped.T]
        # What of each kick nothing else does, (m, n, cycles).
        of_torques = np.stack([self._left(whole[:, :, at], at) for at in range(torques)])
        #: The same one behind the other, (n, m·cycles), and what they are in all (n, m).
        self._transients = np.ascontiguousarray(of_torques.transpose(1, 0, 2)).reshape(count, -1)
        self._energies = np.ascontiguousarray(np.sum(of_torques**2, axis=2).T)
        self._products, self._sizes = np.zeros(count), np.zeros(count)
        self.reset()

    def _left(self, values: Vector, torque: int) -> Vector:
        """Of values (…, cycles) what neither an offset nor a step of the load makes."""
        basis = self._bases[torque]
        left: Vector = values - (values @ basis) @ basis.T
        return left

    def reset(self) -> None:
        """What was before says nothing any more."""
        self._values = np.zeros((self._cycles, len(self._bases)))
        self._filled, self._best, self._since = 0, 0.0, 0
        self._found: Transient | None = None

    def take(self, torques_Nm: Vector, variances: Vector) -> Transient | None:
        """Torques (m,) beside those of the line that is followed, with the variances of their noise; a kick once it is
        decided."""
        self._filled += 1
        _take(self._values, torques_Nm, variances, self._transients, self._energies, self._products, self._sizes)
        if self._filled < self._cycles:
            return None
        products, sizes, weights = self._products, self._sizes, 1.0 / variances
        gains = products**2 / sizes
        at = int(np.argmax(gains))
        self._since += 1
        if gains[at] > max(self._best, _MAY_BE**2):
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
        """Whether the kick is most of what happens."""
        left = [self._left(values, torque) for torque, values in enumerate(self._values.T)]
        rest = sum(weight * float(each @ each) for weight, each in zip(weights.tolist(), left, strict=True)) - gain
        expected = len(weights) * self._cycles
        return bool(rest - expected < _LEFT_SHARE * gain + _LEFT_NOISE * sqrt(2.0 * expected))
