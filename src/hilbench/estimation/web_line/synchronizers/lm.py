"""Levenberg–Marquardt on a moving window of the filtered balance (scipy's MINPACK), every few cycles."""

from __future__ import annotations

import numpy as np

from hilbench.estimation.web_line.config import LmConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant
from hilbench.estimation.web_line.synchronizers.regression import PARAMETERS, Array
from hilbench.estimation.web_line.synchronizers.window import FittedToWindow


class LmSynchronizer(FittedToWindow):
    """Least-squares solution of the window, started at the previous one."""

    def __init__(self, config: LmConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._every_cycles = config.every_cycles
        self._theta = np.array([1.0] + [0.0] * (PARAMETERS - 1))
        self._cycle = 0

    def update(self, sample: SyncSample) -> Estimate:
        """Take one row; solve when it is due."""
        self._cycle += 1
        if self._window.update(sample) and self._cycle % self._every_cycles == 0:
            self._solve()
        return self._estimate

    def _solve(self) -> None:
        from scipy.optimize import least_squares  # slow to import: deferred to its use

        window, rows = self._window, self._window.rows()
        start = self._theta[window.active]

        def residuals(theta: Array) -> Array:
            return window.residuals(rows, theta)

        solution = least_squares(residuals, start, method="lm").x
        self._theta = window.full(solution)
        self._take(self._theta, window.deviations(rows, solution))
