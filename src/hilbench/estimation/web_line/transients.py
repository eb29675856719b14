"""Matched-filter detector of a sudden change of E at a carriage, by its tension transient.

Another E of the web at a dancer changes the tension at once, until the carriage has moved: it oscillates against the
web, and the torques of the neighbouring rollers with it. A slip at a roller, or entering web with another strain,
begins without that. The torques are compared with the transients of steps of several sizes, as a stiffer web oscillates
faster, orthogonal to other changes at the same instant: a constant load step at each roller.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import Reals, Reals2, Vector, compiled, record_type, rows_of
from hilbench.estimation.assumptions import CERTAIN

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


#: State of a detector: samples, best gain and samples since, whether there is a transient of it.
DETECTOR: Final = record_type("filled", "best", "since", "found")


class TransientArrays(NamedTuple):
    """Of a detector: the last samples (cycles, m); transients (n, m·cycles), with energies (n, m); their correlations
    with the samples and their sizes (n,), weighted by variances."""

    state: Annotated[Any, DETECTOR]
    values: Reals2
    transients: Reals2
    energies: Reals2
    products: Reals
    sizes: Reals


ROWS: Final = rows_of(TransientArrays)


@compiled
def take(d: TransientArrays, torques: Vector, variances: Vector) -> bool:
    """Take torque residuals (m,) to the simulated line, with their noise variances; True if `TransientDetector.decide`
    may have something to do."""
    s, values, best = d.state, d.values, 0.0
    cycles, m = values.shape
    for c in range(cycles - 1):
        for j in range(m):
            values[c, j] = values[c + 1, j]
    for j in range(m):
        values[cycles - 1, j] = torques[j]
    s.filled += 1.0
    if s.filled < cycles:
        return False
    for i in range(len(d.products)):
        d.products[i] = d.sizes[i] = 0.0
        for j in range(m):
            product = 0.0
            for c in range(cycles):
                product += d.transients[i, j * cycles + c] * values[c, j]
            d.products[i] += product / variances[j]
            d.sizes[i] += d.energies[i, j] / variances[j]
        best = max(best, d.products[i] * d.products[i] / d.sizes[i])
    s.since += 1.0
    is_due = s.since >= (_DECIDED * (cycles - BEFORE) if s.found != 0.0 else cycles)
    return bool(best > max(s.best, CERTAIN**2) or (is_due and s.best != 0.0))


class TransientDetector:
    """Matched filter. `transients` (n, M, m): response of each of m torques in M cycles from a step of E on, over its
    size; `loads` (M, m): response to a load step at its own roller."""

    def __init__(self, transients: Vector, loads: Vector) -> None:
        count, cycles, torques = transients.shape
        self._cycles = BEFORE + cycles
        whole = np.concatenate([np.zeros((count, BEFORE, torques)), transients], axis=1)
        stepped = np.concatenate([np.zeros((BEFORE, torques)), loads])
        self._bases = [np.linalg.qr(np.stack([np.ones(self._cycles), each], axis=1))[0] for each in stepped.T]
        # Part of each transient orthogonal to offset and load step, (m, n, cycles).
        of_torques = np.stack([self._left(whole[:, :, at], at) for at in range(torques)])
        self.arrays = TransientArrays(
            np.zeros(1, DETECTOR),
            np.zeros((self._cycles, torques)),
            np.ascontiguousarray(of_torques.transpose(1, 0, 2)).reshape(count, -1),
            np.ascontiguousarray(np.sum(of_torques**2, axis=2).T),
            *(np.zeros(count), np.zeros(count)),
        )
        self._found: Transient | None = None

    def _left(self, values: Vector, torque: int) -> Vector:
        """Residual of values (…, cycles) after an offset and a load step."""
        basis = self._bases[torque]
        left: Vector = values - (values @ basis) @ basis.T
        return left

    def reset(self) -> None:
        """Forget all samples."""
        self.arrays.values[:] = 0.0
        self.arrays.state[:] = 0.0
        self._found = None

    def decide(self, variances: Vector) -> Transient | None:
        """Decide on the torque residuals taken last, with their noise variances (m,); returns a transient once it is
        decided."""
        s, products, sizes = self.arrays.state[0], self.arrays.products, self.arrays.sizes
        if s["filled"] < self._cycles:
            return None
        gains = products**2 / sizes
        at = int(np.argmax(gains))
        if gains[at] > max(s["best"], CERTAIN**2):
            share = float(products[at] / sizes[at])
            s["best"], s["since"] = gains[at], 0.0
            deviation = hypot(1.0 / sqrt(float(sizes[at])), _OF_MODEL * share)
            sure = bool(gains[at] > _STANDS_OUT**2)
            fits = self._fits(float(gains[at]), 1.0 / variances)
            self._found = Transient(share, deviation, 0, sure) if fits else None
            s["found"] = fits
        if s["best"] and self._found is None and s["since"] >= self._cycles:
            s["best"] = 0.0
        if self._found is None or s["since"] < _DECIDED * (self._cycles - BEFORE):
            return None
        found, since = self._found, int(s["since"])
        self.reset()
        return Transient(found.share, found.deviation, self._cycles - BEFORE + since, found.sure)

    def _fits(self, gain: float, weights: Vector) -> bool:
        """True if the transient explains most of the signal."""
        left = [self._left(values, torque) for torque, values in enumerate(self.arrays.values.T)]
        rest = sum(weight * float(each @ each) for weight, each in zip(weights.tolist(), left, strict=True)) - gain
        expected = len(weights) * self._cycles
        return bool(rest - expected < _LEFT_SHARE * gain + _LEFT_NOISE * sqrt(2.0 * expected))
