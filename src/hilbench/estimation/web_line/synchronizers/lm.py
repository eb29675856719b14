"""Levenberg–Marquardt on a moving window of the filtered balance (scipy's MINPACK), every few cycles."""

from __future__ import annotations

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.web_line.config import LmConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.window import FittedToWindow


class LmSynchronizer(FittedToWindow):
    """Least-squares solution of the window, started at the previous one."""

    def __init__(self, config: LmConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._every_cycles = config.every_cycles
        self._theta = np.array([1.0] + [0.0] * (np.count_nonzero(self._active) - 1))
        self._cycle = 0

    def update(self, sample: SyncSample) -> Estimate:
        """Take one row; solve when it is due."""
        self._cycle += 1
        if self._add(sample) and self._cycle % self._every_cycles == 0:
            self._solve()
        return self._estimate

    def _solve(self) -> None:
        from scipy.optimize import least_squares  # slow to import: deferred to its use

        rows = self._window()

        def residuals(theta: Array) -> Array:
            return self._residuals(rows, theta)

        self._theta = least_squares(residuals, self._theta, method="lm").x
        self._estimate = self._fitted(rows, self._theta)
