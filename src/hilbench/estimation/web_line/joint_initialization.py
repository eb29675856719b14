"""Joint initialization of E and strain of webs first seen running, or at rest.

The encoders' strain starts from a guess. Its initial error leaves the span with the web, as exp(-s/L) of the travel s,
and enters the next span. The tension by the torque is then

    F_k = E_k·S·ε_k + E_k·S·Σ_j share_kj(s)·δ_j

with the strain ε from the guess, the initial errors δ_j of span j, and their shares in span k now: linear in E and E·δ.
Recursive least squares on the filtered balance (`synchronizers.regression`) find these while web of unknown strain is
still in the line. Identifiability: at first the two are the same; after half a span they begin to separate, as the
deviation shows. Each span gets the estimated strains of the others from the one that its web comes from.

At rest they are never separable. There one roller has to move against the other by a little. Then, and at rest, dry
friction beyond the model's takes an unknown part of the tension: one in the direction of a slow motion, and one at
rest, in addition to the two, each with its usual size. The one at rest is constant until the tension changes: the load
of a roller at rest follows that, whether it breaks loose or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, inf, sqrt

import numpy as np

from hilbench.estimation.assumptions import CERTAIN
from hilbench.estimation.web_line.initial_strains import PRIOR, SLOW_M_S, Array, InitialStrains, Strains
from hilbench.estimation.web_line.synchronizers.base import Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.regression import FILTER_S, RegressionRows, noise_gain
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S

#: Deviation of E and of the strain, in %, at which a web counts as known: while it passes, which soon replaces it by a
#: better known one, and at rest, where a movement takes so long.
_FOUND_PCT, _FOUND_AT_REST_PCT = 0.3, 0.33
#: Rows before their residual is used as the noise.
_SETTLED = 30
#: Rows from one solution to the next.
_EVERY = 5
#: Least noise variance of a row, as a share of the tension.
_LEAST_VARIANCE = 1e-8
#: Least E over its prior value, for the information on other spans.
_LEAST_SHARE = 0.01
#: Filtered speeds (m/s) up to which a roller is at rest, and from which on all of its dry friction acts against its
#: direction. It counts as unknown below `SLOW_M_S`: at line speed it belongs to `unmodelled_effects`.
_STANDSTILL_M_S, _MOVES_M_S = 1e-4, FRICTION_WIDTH_M_S
#: Relative change of the strain from which on the tension differs from that when the roller came to rest.
_PULLED = 0.02
#: Least remaining share of a web moved to and fro by the rollers, as for a movement at rest.
_STAYS = 0.9
#: Unknowns: E, E·δ of the span, friction in the direction of a slow motion, force taken up at rest; then E·δ with the δ
#: of the other spans.
_MODULUS, _STRAIN, _FRICTION, _AT_REST, _OTHERS = range(5)


@dataclass(frozen=True, slots=True)
class InitialWeb:
    """Estimate of a web: E in Pa, strain beyond the guess, and dry friction (N) beyond the model's, with standard
    deviations."""

    youngs_modulus_Pa: float
    deviation_Pa: float
    strain_error: float
    strain_deviation: float
    friction_N: float
    friction_deviation_N: float

    @property
    def sticks(self) -> bool:
        """True if dry friction beyond the model's is certain."""
        return self.friction_N > CERTAIN * self.friction_deviation_N


class JointInitialization:
    """Least squares since the twin has joined, for a span (from 0) of `webs`; `strain_scale`: usual strain;
    `friction_share`: standard deviation of dry friction beyond the model's, as a share of the tension at that strain.
    """

    def __init__(
        self, plant: Plant, webs: InitialStrains, span: int, strain_scale: float, friction_share: float
    ) -> None:
        self.found: InitialWeb | None = None  #: latest estimate
        self._plant = plant
        self._webs, self._span = webs, span
        count = len(webs.shares)
        self._others = np.delete(np.arange(count), span)
        self._scale = strain_scale
        self._force_N = plant.youngs_modulus_Pa * plant.section_m2 * strain_scale  # unit of all rows
        self._rows = RegressionRows(plant)
        self._left = webs.shares[span].copy()  # shares as of the last row
        self._filtered = [self._left, self._left]  # the same after one and both low passes of the rows
        self._unknowns = _OTHERS + len(self._others)
        self._strains = np.insert(np.arange(_OTHERS, self._unknowns), span, _STRAIN)  # indices of E·δ, by span
        weights = np.array([PRIOR, PRIOR, friction_share, friction_share]) ** -2.0  # prior: E and friction
        self._weights = np.diag(np.concatenate([weights, np.zeros(len(self._others))]))
        self._products = np.zeros((self._unknowns, self._unknowns))
        self._vector = np.zeros(self._unknowns)
        self._square = 0.0
        self._count = 0
        self._has_rested = False
        self._rests_at = 0.0  # filtered tension per E at rest
        self._has_moved = False  # from then on friction at rest takes another part

    @property
    def passes(self) -> bool:
        """True if the initial web has begun to leave, which separates its strain from E."""
        return self._webs.shares.item(self._span, self._span) < _STAYS

    def deviation_Pa(self, youngs_modulus_Pa: float) -> float:
        """Standard deviation of this E, by the estimate or its prior."""
        found = self.found
        if found is None:
            return PRIOR * self._plant.youngs_modulus_Pa
        return hypot(found.deviation_Pa, found.youngs_modulus_Pa - youngs_modulus_Pa)

    def look(self, sample: SyncSample | None, cycle_s: float, strain: float) -> InitialWeb | None:
        """Take the balance of a cycle, after the web's move; None: unusable. `strain`: by the guess.

        Returns the estimate once it is good enough for a method, else None.
        """
        if sample is None:
            self._rows.interrupt()
            self._filter(cycle_s)
            return None
        found = self.update(sample)
        if found is None or not self._webs.enters_known(self._span):
            return None
        share = 0.01 * (_FOUND_PCT if self.passes else _FOUND_AT_REST_PCT)
        strain += found.strain_error
        unsure = found.deviation_Pa > share * found.youngs_modulus_Pa or found.strain_deviation > share * strain
        return None if unsure else found

    def update(self, sample: SyncSample) -> InitialWeb | None:
        """Take the balance of a cycle, after the web's move; None until there is an estimate."""
        ready = self._rows.update(sample)
        self._filter(sample.cycle_s)
        if not ready:
            return self.found
        row = self._rows.row
        speed_m_s = float(row[2])
        at_standstill = abs(speed_m_s) <= _STANDSTILL_M_S and not self._has_moved
        moves = abs(speed_m_s) >= _MOVES_M_S
        # A roller at rest takes up a growing load, and stays at rest as long as its friction can.
        if at_standstill and self._has_rested and abs(row[0] - self._rests_at) > _PULLED * abs(self._rests_at):
            at_standstill, self._has_moved = False, True
        # Several rollers count as one only when they move alike.
        at_standstill = at_standstill and self._webs.go_along(self._span, 0.0, _STANDSTILL_M_S)
        moves = moves and self._webs.go_along(self._span, speed_m_s, _MOVES_M_S)
        if at_standstill and not self._has_rested:
            self._has_rested, self._rests_at = True, float(row[0])
        self._has_moved = self._has_moved or moves
        if not (at_standstill or moves):  # friction may have any value between the two
            return self.found
        regressors = np.zeros(self._unknowns)
        regressors[_MODULUS], regressors[_STRAIN] = row[0] / self._force_N, self._filtered[1][self._span]
        regressors[_OTHERS:] = self._filtered[1][self._others]
        regressors[_AT_REST] = at_standstill
        if moves and abs(speed_m_s) < SLOW_M_S:
            regressors[_FRICTION] = np.sign(speed_m_s)
        force = float(row[-1]) / self._force_N
        self._products += np.outer(regressors, regressors)
        self._vector += regressors * force
        self._square += force * force
        self._count += 1
        if self._count > _SETTLED and self._count % _EVERY == 0:
            self.found = self._solved(noise_gain(sample.cycle_s))
        return self.found

    def _filter(self, cycle_s: float) -> None:
        decay, left = exp(-cycle_s / FILTER_S), self._left
        first, second = self._filtered
        first = left + (first - left) * decay
        self._filtered = [first, first + (second - first) * decay]
        self._left = self._webs.shares[self._span].copy()

    def _of_others(self) -> Array:
        """Information (U, U) on the other strains: E·δ less E times the estimate of δ is 0."""
        known, at = self._webs.estimate_before(self._span), self._others
        share = 1.0 if self.found is None else self.found.youngs_modulus_Pa / self._plant.youngs_modulus_Pa
        conditions = np.zeros((len(at), self._unknowns))
        conditions[:, _MODULUS], conditions[:, _OTHERS:] = -known.mean[at], np.eye(len(at))
        return (
            np.asarray(conditions.T @ np.linalg.solve(known.covariance[np.ix_(at, at)], conditions))
            / max(share, _LEAST_SHARE) ** 2
        )

    def _solved(self, gain: float) -> InitialWeb:
        """Solution of the least squares; noise after the filter is scaled to that before it."""
        of_others = self._of_others()
        # The noise by the rows alone, which sets their weight relative to the prior.
        theta = np.linalg.solve(self._products + _LEAST_VARIANCE * (self._weights + of_others), self._vector)
        over = self._square - 2.0 * float(theta @ self._vector) + float(theta @ self._products @ theta)
        variance = max(max(over, 0.0) / (self._count - 2) / gain, _LEAST_VARIANCE)
        covariance = np.linalg.inv(self._products / variance + self._weights + of_others)
        # At rest rows add no information by repetition. With running webs, neighbours may be initialized at the same
        # time and disturb rows by more than noise: there the prior weighs as rows do.
        weights = self._weights * (variance if self._has_rested else 1.0)
        theta = np.linalg.solve(self._products + weights + variance * of_others, self._vector + weights[_MODULUS])
        share = theta[_MODULUS].item()
        share_sd, _, friction_sd, _ = np.sqrt(np.diag(covariance))[:_OTHERS].tolist()
        strain_error = strain_sd = inf
        if share > 0.0:
            # The next span gets the estimate of all δ.
            mean, slopes = theta[self._strains] / share, np.zeros((len(self._strains), self._unknowns))
            slopes[np.arange(len(mean)), self._strains], slopes[:, _MODULUS] = 1.0 / share, -mean / share
            self._webs.estimates[self._span] = Strains(mean, slopes @ covariance @ slopes.T)
            # Sensitivities of the strain's error to the unknowns, whose errors correlate.
            slope, at, left = np.zeros(self._unknowns), self._strains, self._left
            slope[at] = self._scale * left / share
            slope[_MODULUS] = np.sum(-theta[at] / share * self._scale * left / share)
            strain_error, strain_sd = float(theta[at] @ slope[at]), sqrt(float(slope @ covariance @ slope))
        return InitialWeb(
            share * self._plant.youngs_modulus_Pa,
            share_sd * self._plant.youngs_modulus_Pa,
            strain_error,
            strain_sd,
            theta[_FRICTION].item() * self._force_N,
            friction_sd * self._force_N,
        )
