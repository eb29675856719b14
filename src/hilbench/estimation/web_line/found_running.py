"""E and the strain of a web that is found under way, together.

The strain that the encoders show goes from a guess: what it is off by at the start leaves the span with the web, as
exp(-s/L) of the way s. The tension that the torque shows is then

    F = E·S·ε + E·S·δ·exp(-s/L)

with the strain ε that follows from the guess, which is linear in E and E·δ: recursive least squares on the filtered
balance (`synchronizers.regression`) find both while the web that could not be known is still in the span. At first
the two are the same; after half a span they begin to part, and the deviation says how far.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf

import numpy as np

from hilbench.estimation.web_line.synchronizers.base import SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant
from hilbench.estimation.web_line.synchronizers.regression import FILTER_S, RegressionRows, noise_gain

#: What is believed of E and E·δ beforehand, over E and E·ε: next to nothing.
_PRIOR = 2.0
#: Rows before the noise, which is what they leave over, is believed.
_SETTLED = 30
#: Noise of a row that there is at least, as a share of the tension.
_LEAST_VARIANCE = 1e-8


@dataclass(frozen=True, slots=True)
class FoundWeb:
    """What is known of a web now: E in Pa, and what its strain is beyond the guessed one, with standard deviations."""

    youngs_modulus_Pa: float
    deviation_Pa: float
    strain_error: float
    strain_deviation: float


class FoundRunning:
    """Least squares since the twin has joined; `strain_scale`: what strains are like."""

    def __init__(self, plant: Plant, strain_scale: float) -> None:
        self._plant = plant
        self._scale = strain_scale
        self._force_N = plant.youngs_modulus_Pa * plant.section_m2 * strain_scale  # unit of all rows
        self._rows = RegressionRows(plant)
        self._left = 1.0  # of the web that was there at the start
        self._filtered = [1.0, 1.0]  # the same behind one and both low passes of the rows
        self._products = np.zeros((2, 2))
        self._vector = np.zeros(2)
        self._square = 0.0
        self._count = 0

    def skip(self, velocity_m_s: float, cycle_s: float) -> None:
        """A cycle without a usable measurement."""
        self._rows.interrupt()
        self._transport(velocity_m_s, cycle_s)

    def update(self, sample: SyncSample) -> FoundWeb | None:
        """Take the balance of a cycle; None while nothing can be said."""
        ready = self._rows.update(sample)
        self._transport(sample.balance.velocity_m_s, sample.cycle_s)
        if not ready:
            return None
        row = self._rows.row
        regressors = np.array([row[0] / self._force_N, self._filtered[1]])
        force = float(row[-1]) / self._force_N
        self._products += np.outer(regressors, regressors)
        self._vector += regressors * force
        self._square += force * force
        self._count += 1
        return self._found(noise_gain(sample.cycle_s)) if self._count > _SETTLED else None

    def _transport(self, velocity_m_s: float, cycle_s: float) -> None:
        decay = exp(-cycle_s / FILTER_S)
        first, second = self._filtered
        first = self._left + (first - self._left) * decay
        self._filtered = [first, first + (second - first) * decay]
        self._left *= exp(-abs(velocity_m_s) * cycle_s / self._plant.span_length_m)

    def _found(self, gain: float) -> FoundWeb:
        """The solution; noise behind the filter counts as what it was before it."""
        prior = np.eye(2) / _PRIOR**2
        believed = prior @ np.array([1.0, 0.0])
        theta = np.linalg.solve(self._products + prior, self._vector + believed)
        over = self._square - 2.0 * float(theta @ self._vector) + float(theta @ self._products @ theta)
        variance = max(over, 0.0) / (self._count - 2) / gain
        covariance = np.linalg.inv(self._products / max(variance, _LEAST_VARIANCE) + prior)
        (share, extra), (share_sd, extra_sd) = theta.tolist(), np.sqrt(np.diag(covariance)).tolist()
        scale = self._scale * self._left / share if share > 0.0 else inf
        return FoundWeb(
            share * self._plant.youngs_modulus_Pa,
            share_sd * self._plant.youngs_modulus_Pa,
            extra * scale,
            extra_sd * scale,
        )
