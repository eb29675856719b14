"""E and the strain of a web that is found under way, or at rest, together.

The strain that the encoders show goes from a guess: what it is off by at the start leaves the span with the web, as
exp(-s/L) of the way s. The tension that the torque shows is then

    F = E·S·ε + E·S·δ·exp(-s/L)

with the strain ε that follows from the guess, which is linear in E and E·δ: recursive least squares on the filtered
balance (`synchronizers.regression`) find both while the web that could not be known is still in the span. At first
the two are the same; after half a span they begin to part, and the deviation says how far.

At rest they stay the same, however long it lasts. There one roller has to move against the other by a little. Then, and
at rest, dry friction that the model does not know takes up an unknown part of the tension: one that goes with the
direction of a slow motion, and one at rest, beside the two, each as large as is usual.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, inf

import numpy as np

from hilbench.estimation.web_line.synchronizers.base import SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant
from hilbench.estimation.web_line.synchronizers.regression import FILTER_S, RegressionRows, noise_gain
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S

#: What is believed of E and E·δ beforehand, over E and E·ε: next to nothing.
_PRIOR = 2.0
#: Rows before the noise, which is what they leave over, is believed.
_SETTLED = 30
#: Rows from one solution to the next.
_EVERY = 5
#: Noise of a row that there is at least, as a share of the tension.
_LEAST_VARIANCE = 1e-8
#: Speeds (m/s, behind the filter) up to which a roller stands, from which on all of its dry friction goes with its
#: direction, and below which that counts as unknown: where the line runs, that is for `model_errors`.
_STANDS_M_S, _MOVES_M_S, _SLOW_M_S = 1e-4, FRICTION_WIDTH_M_S, 0.02
#: Deviations beyond which friction is there.
_SURE = 4.0
#: What is left at least of a web that goes to and fro with the rollers, as a movement at rest takes it.
_STAYS = 0.9
#: What is solved for: E, E·δ, friction in the direction of a slow motion, what is taken up at rest.
_UNKNOWNS = 4
_MODULUS, _STRAIN, _FRICTION, _AT_REST = range(_UNKNOWNS)


@dataclass(frozen=True, slots=True)
class FoundWeb:
    """What is known of a web now: E in Pa, what its strain is beyond the guessed one, and dry friction (N) beyond the
    model's, with standard deviations."""

    youngs_modulus_Pa: float
    deviation_Pa: float
    strain_error: float
    strain_deviation: float
    friction_N: float
    friction_deviation_N: float

    @property
    def sticks(self) -> bool:
        """Whether there is such friction."""
        return self.friction_N > _SURE * self.friction_deviation_N


class FoundRunning:
    """Least squares since the twin has joined; `strain_scale`: what strains are like; `friction_share`: what dry
    friction is like that the model does not know, of the tension at that strain (standard deviation)."""

    def __init__(self, plant: Plant, strain_scale: float, friction_share: float) -> None:
        self.found: FoundWeb | None = None  #: what has been found by now
        self._plant = plant
        self._scale = strain_scale
        self._force_N = plant.youngs_modulus_Pa * plant.section_m2 * strain_scale  # unit of all rows
        self._rows = RegressionRows(plant)
        self._left = 1.0  # of the web that was there at the start
        self._filtered = [1.0, 1.0]  # the same behind one and both low passes of the rows
        believed = np.array([_PRIOR, _PRIOR, friction_share, friction_share])  # around E as it was, and nothing else
        self._weights = np.diag(believed**-2.0)
        self._products = np.zeros((_UNKNOWNS, _UNKNOWNS))
        self._vector = np.zeros(_UNKNOWNS)
        self._square = 0.0
        self._count = 0
        self._has_rested = False
        self._has_moved = False  # another time friction at rest would take up another part

    @property
    def passes(self) -> bool:
        """Whether the web that was there has begun to leave."""
        return self._left < _STAYS

    def deviation_Pa(self, youngs_modulus_Pa: float) -> float:
        """What this E may be off by (standard deviation), as far as anything is known of the web."""
        found = self.found
        if found is None:
            return _PRIOR * self._plant.youngs_modulus_Pa
        return hypot(found.deviation_Pa, found.youngs_modulus_Pa - youngs_modulus_Pa)

    def skip(self, velocity_m_s: float, cycle_s: float) -> None:
        """A cycle without a usable measurement."""
        self._rows.interrupt()
        self._transport(velocity_m_s, cycle_s)

    def update(self, sample: SyncSample) -> FoundWeb | None:
        """Take the balance of a cycle; None while nothing can be said."""
        ready = self._rows.update(sample)
        self._transport(sample.balance.velocity_m_s, sample.cycle_s)
        if not ready:
            return self.found
        row = self._rows.row
        speed_m_s = float(row[2])
        stands, moves = abs(speed_m_s) <= _STANDS_M_S and not self._has_moved, abs(speed_m_s) >= _MOVES_M_S
        self._has_rested, self._has_moved = self._has_rested or stands, self._has_moved or moves
        if not (stands or moves):  # friction may be anything between its two values
            return self.found
        regressors = np.zeros(_UNKNOWNS)
        regressors[_MODULUS], regressors[_STRAIN] = row[0] / self._force_N, self._filtered[1]
        regressors[_AT_REST] = stands
        if moves and abs(speed_m_s) < _SLOW_M_S:
            regressors[_FRICTION] = np.sign(speed_m_s)
        force = float(row[-1]) / self._force_N
        self._products += np.outer(regressors, regressors)
        self._vector += regressors * force
        self._square += force * force
        self._count += 1
        if self._count > _SETTLED and self._count % _EVERY == 0:
            self.found = self._solved(noise_gain(sample.cycle_s))
        return self.found

    def _transport(self, velocity_m_s: float, cycle_s: float) -> None:
        decay = exp(-cycle_s / FILTER_S)
        first, second = self._filtered
        first = self._left + (first - self._left) * decay
        self._filtered = [first, first + (second - first) * decay]
        self._left *= exp(-abs(velocity_m_s) * cycle_s / self._plant.span_length_m)

    def _solved(self, gain: float) -> FoundWeb:
        """The solution; noise behind the filter counts as what it was before it."""
        # The noise by the rows alone, which tells how much they weigh beside what is believed.
        theta = np.linalg.solve(self._products + _LEAST_VARIANCE * self._weights, self._vector)
        over = self._square - 2.0 * float(theta @ self._vector) + float(theta @ self._products @ theta)
        variance = max(max(over, 0.0) / (self._count - 2) / gain, _LEAST_VARIANCE)
        covariance = np.linalg.inv(self._products / variance + self._weights)
        # At rest the rows tell no more than they do. Under way webs around this one may be found at the same time, and
        # put rows off by more than noise: there what is believed weighs as rows do.
        weights = self._weights * (variance if self._has_rested else 1.0)
        theta = np.linalg.solve(self._products + weights, self._vector + weights[_MODULUS])
        share, extra = theta[_MODULUS].item(), theta[_STRAIN].item()
        share_sd, _, friction_sd, _ = np.sqrt(np.diag(covariance)).tolist()
        strain_error = strain_sd = inf
        if share > 0.0:
            slope = np.zeros(_UNKNOWNS)  # of the strain's error over the unknowns, whose errors go together
            slope[[_MODULUS, _STRAIN]] = np.array([-extra / share, 1.0]) * self._scale * self._left / share
            strain_error, strain_sd = extra * slope.item(_STRAIN), float(np.sqrt(slope @ covariance @ slope))
        return FoundWeb(
            share * self._plant.youngs_modulus_Pa,
            share_sd * self._plant.youngs_modulus_Pa,
            strain_error,
            strain_sd,
            theta[_FRICTION].item() * self._force_N,
            friction_sd * self._force_N,
        )
