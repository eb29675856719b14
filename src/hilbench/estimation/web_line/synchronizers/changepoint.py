"""Change-point estimator of E: bank of Kalman filters (`kalman`), one per hypothesis of its last change (`bank`)."""

from __future__ import annotations

import numpy as np

from hilbench.estimation import bank
from hilbench.estimation.assumptions import SEPARABLE
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.config import ChangepointConfig
from hilbench.estimation.web_line.synchronizers import filters, kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, Synchronizer, SyncSample
from hilbench.estimation.web_line.synchronizers.filters import FilterArrays, Filters


class ChangepointSynchronizer(Synchronizer):
    """Estimator of E by a bank of Kalman filters."""

    def __init__(self, config: ChangepointConfig, plant: Plant) -> None:
        births = config.jumps_per_s, config.drift_onsets_per_s
        self._filters = Filters(config, plant, (config.jump_pct, config.drift_pct_per_s, bank.CAPACITY), births)
        self._filters.inputs["parameter_variance_per_s"] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self.arrays: FilterArrays = self._filters.arrays  #: for compiled callers
        self.arrays.stated["cautious"] = 0.01 * config.cautious_pct
        self._has_nuisances = bool(self.arrays.stated["has_nuisances"])

    @property
    def is_compiled(self) -> bool:
        """True if `filters.follow` and `filters.state` are a complete update: started, and without nuisance
        parameters."""
        return self._filters.started and not self._has_nuisances

    def update(self, sample: SyncSample) -> Estimate:
        """Step every hypothesis by one cycle and add the births of the next."""
        if self._filters.take(filters.FOLLOW, sample):
            self._filters.act(filters.STATE, self._of_what_is_held() if self._has_nuisances else 0.0)
        return self.estimate

    def _of_what_is_held(self) -> float:
        """Contribution to E of nuisance parameters that the data don't separate from it: they are held at 0, their
        prior."""
        priors, (mean, deviations, _), covariance = self._filters.priors, self.arrays.bank.out, self.arrays.covariance
        inseparable = (priors > 0.0) & (deviations[kalman.OFFSET :] >= SEPARABLE * priors)
        held = kalman.OFFSET + np.flatnonzero(inseparable)
        if not held.size:
            return 0.0
        gain = np.linalg.solve(covariance[np.ix_(held, held)], covariance[held, kalman.E])
        return float(gain @ mean[held])

    def rebase(self, change_Pa: float) -> None:
        """Shift E of every hypothesis."""
        self._filters.act(filters.REBASE, change_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Widen E in every hypothesis (random walk); reset position and velocity."""
        self._filters.hold(duration_s)
        return self.estimate

    @property
    def estimate(self) -> Estimate:
        """Estimate of the last cycle."""
        self._filters.act(filters.NOTHING)
        return Estimate(self._filters.modulus_Pa, self._filters.deviation_Pa, self.nuisances)

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters estimated in addition to E."""
        mean, deviation, _ = self.arrays.bank.out
        return self._filters.estimate(mean, deviation).nuisances

    @property
    def separable(self) -> bool:
        """True if the data separate all nuisance parameters from E."""
        self._filters.act(filters.NOTHING)
        return self._filters.separable
