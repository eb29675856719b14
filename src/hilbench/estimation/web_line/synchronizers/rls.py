"""Recursive least squares with exponential forgetting on the filtered momentum balance.

Source: Åström and Wittenmark, Adaptive Control, section 2.2. The nuisances' prior does not fade with the data: its
forgotten share is added again each cycle.
"""

from __future__ import annotations

from math import exp

import numpy as np

from hilbench.estimation.assumptions import MOST_SQUARE
from hilbench.estimation.web_line.config import RlsConfig
from hilbench.estimation.web_line.synchronizers.base import (
    Estimate,
    HeldSynchronizer,
    Plant,
    SyncSample,
    estimate_of,
    prior_deviations,
)
from hilbench.estimation.web_line.synchronizers.regression import PARAMETERS, RegressionRows, noise_gain


class RlsSynchronizer(HeldSynchronizer):
    """Recursive least squares of θ = [E/E0, offset, viscous, dry, mass] by its information matrix and vector."""

    def __init__(self, config: RlsConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._config, self._also = config, config.also
        self._rows = RegressionRows(plant)
        priors = prior_deviations(config.also)
        # A nuisance that is not estimated gets a fixed prior.
        self._prior = np.diag(np.concatenate([[0.0], 1.0 / np.maximum(priors, 1e-9) ** 2]))
        noise_N = config.torque_noise_Nm * plant.force_per_torque_per_m
        self._variance_N2 = noise_N**2
        self._information = np.zeros((PARAMETERS, PARAMETERS))
        self._information[0, 0] = (100.0 / config.initial_deviation_pct) ** 2
        self._vector = np.zeros(PARAMETERS)
        self._vector[0] = self._information[0, 0]
        self._theta = np.array([1.0] + [0.0] * (PARAMETERS - 1))
        self._estimate = self._stated()

    def update(self, sample: SyncSample) -> Estimate:
        """Forget a little, add one row, solve."""
        if not self._rows.update(sample):
            return super().hold(sample.cycle_s)
        keep = exp(-sample.cycle_s / self._config.memory_s)
        row, y = self._rows.row[:PARAMETERS], self._rows.row[PARAMETERS]
        error_N = y - row @ self._theta
        share = sample.cycle_s / (10.0 * self._config.memory_s)
        self._variance_N2 += share * (min(error_N**2, MOST_SQUARE * self._variance_N2) - self._variance_N2)
        # The filter makes the noise smaller and correlated; over many rows it counts as before the filter. Exponential
        # weights have twice the information of their sum of squares (Σλ² against (Σλ)²).
        weight = 2.0 * noise_gain(sample.cycle_s) / self._variance_N2
        self._information = keep * self._information + weight * np.outer(row, row)
        self._vector = keep * self._vector + weight * row * y
        self._theta = np.linalg.solve(self._information + self._prior, self._vector)
        self._estimate = self._stated()
        return self._estimate

    def rebase(self, change_Pa: float) -> None:
        """Shift E."""
        change = change_Pa / self._reference_Pa
        self._vector += change * self._information[:, 0]
        self._theta[0] += change

    def hold(self, duration_s: float) -> Estimate:
        """Keep the estimate; restart the filter."""
        self._rows.interrupt()
        return super().hold(duration_s)

    def _stated(self) -> Estimate:
        covariance = np.linalg.inv(self._information + self._prior)
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return estimate_of(self._also, self._reference_Pa, self._theta, deviations)
