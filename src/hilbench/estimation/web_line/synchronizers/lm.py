"""Levenberg–Marquardt on a moving window of the filtered balance (scipy's MINPACK), every few cycles."""

from __future__ import annotations

import numpy as np

from hilbench.estimation.web_line.config import LmConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant, held, nuisances, prior_deviations
from hilbench.estimation.web_line.synchronizers.regression import PARAMETERS, Array
from hilbench.estimation.web_line.synchronizers.window import RowWindow


class LmSynchronizer:
    """The window's least-squares solution, begun at the one before."""

    def __init__(self, config: LmConfig, plant: Plant) -> None:
        self._config = config
        self._also = tuple(config.also)
        self._reference_Pa = plant.youngs_modulus_Pa
        priors = prior_deviations(config.also)
        self._window = RowWindow(plant, config.window_s, config.torque_noise_Nm, priors)
        self._theta = np.array([1.0] + [0.0] * (PARAMETERS - 1))
        self._cycle = 0
        deviation_Pa = 0.01 * config.initial_deviation_pct * plant.youngs_modulus_Pa
        self._estimate = Estimate(plant.youngs_modulus_Pa, deviation_Pa)

    def update(self, sample: SyncSample) -> Estimate:
        """Take one row; solve when it is time."""
        self._cycle += 1
        if self._window.update(sample) and self._cycle % self._config.every_cycles == 0:
            self._solve()
        return self._estimate

    def rebase(self, change_Pa: float) -> None:
        """Move the rows of the window."""
        self._window.rebase(change_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Keep the last solution."""
        self._window.interrupt()
        self._estimate = held(self._estimate, self._config.hold_growth_pct_per_s, duration_s)
        return self._estimate

    def _solve(self) -> None:
        from scipy.optimize import least_squares  # slow to import: only who uses this method waits for it

        window, rows = self._window, self._window.rows()
        start = self._theta[window.active]

        def residuals(theta: Array) -> Array:
            return window.residuals(rows, theta)

        solution = least_squares(residuals, start, method="lm").x
        self._theta = np.zeros(PARAMETERS)
        self._theta[window.active] = solution
        deviations = window.deviations(rows, solution)
        self._estimate = Estimate(
            float(self._theta[0]) * self._reference_Pa,
            float(deviations[0]) * self._reference_Pa,
            nuisances(self._also, self._theta[1:].tolist(), deviations[1:].tolist()),
        )
