"""Change-point estimator of E: bank of Kalman filters (`kalman`), one per hypothesis of its last change (`bank`)."""

from __future__ import annotations

import numpy as np

from hilbench.estimation import bank
from hilbench.estimation.assumptions import SEPARABLE
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.config import ChangepointConfig
from hilbench.estimation.web_line.synchronizers import filters, kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.filters import Filters


class ChangepointSynchronizer(Filters):
    """Estimator of E by a bank of Kalman filters."""

    def __init__(self, config: ChangepointConfig, plant: Plant) -> None:
        births = config.jumps_per_s, config.drift_onsets_per_s
        super().__init__(config, plant, (config.jump_pct, config.drift_pct_per_s, bank.CAPACITY), births)
        self.inputs["parameter_variance_per_s"] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self.arrays.stated["cautious"] = 0.01 * config.cautious_pct
        #: Else `filters.follow` and `filters.state` are a complete update, once it has `started`.
        self.has_nuisances = bool(self.arrays.stated["has_nuisances"])

    def update(self, sample: SyncSample) -> Estimate:
        """Step every hypothesis by one cycle and add the births of the next."""
        if self.take(filters.FOLLOW, sample):
            self.act(filters.STATE, self._of_what_is_held() if self.has_nuisances else 0.0)
        return self.estimate

    def _of_what_is_held(self) -> float:
        """Contribution to E of nuisance parameters that the data don't separate from it: they are held at 0, their
        prior."""
        priors, (mean, deviations, _), covariance = self._priors, self.arrays.bank.out, self.arrays.covariance
        inseparable = (priors > 0.0) & (deviations[kalman.OFFSET :] >= SEPARABLE * priors)
        held = kalman.OFFSET + np.flatnonzero(inseparable)
        if not held.size:
            return 0.0
        gain = np.linalg.solve(covariance[np.ix_(held, held)], covariance[held, kalman.E])
        return float(gain @ mean[held])

    @property
    def estimate(self) -> Estimate:
        """Estimate of the last cycle."""
        self.act(filters.NOTHING)
        return Estimate(self._modulus_Pa, self._deviation_Pa, self.nuisances)

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters estimated in addition to E."""
        mean, deviation, _ = self.arrays.bank.out
        return self._estimate_by(mean, deviation).nuisances

    @property
    def separable(self) -> bool:
        """True if the data separate all nuisance parameters from E."""
        self.act(filters.NOTHING)
        return self._separable
