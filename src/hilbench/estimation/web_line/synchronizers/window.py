"""Moving window of rows of the filtered balance, and the base of methods that fit it at intervals."""

from __future__ import annotations

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.web_line.config import GlobalConfig, LmConfig
from hilbench.estimation.web_line.synchronizers.base import (
    Estimate,
    HeldSynchronizer,
    Plant,
    SyncSample,
    estimate_of,
    prior_deviations,
)
from hilbench.estimation.web_line.synchronizers.regression import PARAMETERS, RegressionRows, noise_gain


class FittedToWindow(HeldSynchronizer):
    """Base of estimators of [E/E0, offset, viscous, dry, mass] by the rows of the last `window_s`."""

    def __init__(self, config: LmConfig | GlobalConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._also, self._priors = config.also, prior_deviations(config.also)
        self._window_s, self._noise_N = config.window_s, config.torque_noise_Nm * plant.force_per_torque_per_m
        self._active = np.concatenate([[True], self._priors > 0.0])  # parameters that are estimated
        self._rows = RegressionRows(plant)
        self._data, self._count = np.zeros((0, PARAMETERS + 1)), 0

    def rebase(self, change_Pa: float) -> None:
        """Shift E of the window's rows."""
        self._data[:, PARAMETERS] += change_Pa / self._reference_Pa * self._data[:, 0]

    def hold(self, duration_s: float) -> Estimate:
        """Keep the last result; start the window anew."""
        self._rows.interrupt()
        self._count = 0
        return super().hold(duration_s)

    def _add(self, sample: SyncSample) -> bool:
        """Take one sample; True if the window has enough rows for a fit, and web tension in one of them."""
        length = max(8, round(self._window_s / sample.cycle_s))
        if len(self._data) != length:
            self._data, self._count = np.zeros((length, PARAMETERS + 1)), 0
        if self._rows.update(sample):
            self._data[self._count % length] = self._rows.row
            self._count += 1
        self._noise_gain = noise_gain(sample.cycle_s)
        return self._count >= length // 4 and bool(np.any(self._data[: self._count, 0]))

    def _window(self) -> Array:
        """Copy of the rows, unordered."""
        return self._data[: min(self._count, len(self._data))].copy()

    def _residuals(self, rows: Array, theta: Array) -> Array:
        """Residuals of the rows, in deviations of the noise before the filter, and of the priors; `theta` of the active
        parameters."""
        held = self._active[1:]
        return np.concatenate([self._errors_N(rows, theta) / self._noise_N, theta[1:] / self._priors[held]])

    def _errors_N(self, rows: Array, theta: Array) -> Array:
        return np.asarray(rows[:, PARAMETERS] - rows[:, :PARAMETERS] @ self._full(theta))

    def _full(self, theta: Array) -> Array:
        """All parameters (5,) from the estimated ones; 0 for the others."""
        full = np.zeros(PARAMETERS)
        full[self._active] = theta
        return full

    def _fitted(self, rows: Array, theta: Array) -> Estimate:
        """Estimate by a fit; its deviations by the information of rows and priors, with the noise that it leaves."""
        scatter_N = float(np.sqrt(np.mean(self._errors_N(rows, theta) ** 2) / self._noise_gain))
        a = rows[:, :PARAMETERS][:, self._active] / max(scatter_N, 1e-9)
        information = a.T @ a
        information[1:, 1:] += np.diag(1.0 / self._priors[self._active[1:]] ** 2)
        deviations = self._full(np.sqrt(np.diag(np.linalg.pinv(information))))
        return estimate_of(self._also, self._reference_Pa, self._full(theta), deviations)
