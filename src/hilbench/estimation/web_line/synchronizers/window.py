"""Moving window of rows of the filtered balance, its residuals, and the base of methods that fit it."""

from __future__ import annotations

import numpy as np

from hilbench.estimation.web_line.config import GlobalConfig, LmConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant, held, nuisances, prior_deviations
from hilbench.estimation.web_line.synchronizers.regression import PARAMETERS, Array, RegressionRows, noise_gain


class RowWindow:
    """Moving window of `window_s`; parameters [E/E0, offset, viscous, dry, mass], residuals in noise deviations."""

    def __init__(self, plant: Plant, window_s: float, torque_noise_Nm: float, priors: Array) -> None:
        self._rows = RegressionRows(plant)
        self._reference_Pa = plant.youngs_modulus_Pa
        self._window_s = window_s
        self._data = np.zeros((0, PARAMETERS + 1))
        self._count = 0
        self._noise_N = torque_noise_Nm * plant.force_per_torque_per_m
        self._active = np.concatenate([[True], priors > 0.0])
        self._priors = priors

    @property
    def active(self) -> Array:
        """Mask of the estimated parameters."""
        return self._active

    def interrupt(self) -> None:
        """Start anew after a missing cycle."""
        self._rows.interrupt()
        self._count = 0

    def update(self, sample: SyncSample) -> bool:
        """Take one sample; True if the window has enough rows for a fit, and web tension in one of them."""
        length = max(8, round(self._window_s / sample.cycle_s))
        if len(self._data) != length:
            self._data = np.zeros((length, PARAMETERS + 1))
            self._count = 0
        if self._rows.update(sample):
            self._data[self._count % length] = self._rows.row
            self._count += 1
        self._noise_gain = noise_gain(sample.cycle_s)
        return self._count >= length // 4 and bool(np.any(self._data[: self._count, 0]))

    def rebase(self, change_Pa: float) -> None:
        """Shift E of all rows by `change_Pa`."""
        self._data[:, PARAMETERS] += change_Pa / self._reference_Pa * self._data[:, 0]

    def rows(self) -> Array:
        """Copy of the rows, unordered."""
        return self._data[: min(self._count, len(self._data))].copy()

    def residuals(self, rows: Array, theta: Array) -> Array:
        """Whitened-equivalent residuals of the rows and of the priors; `theta` of the active parameters."""
        full = self.full(theta)
        error = (rows[:, PARAMETERS] - rows[:, :PARAMETERS] @ full) / self._noise_N
        held = self._active[1:]
        return np.concatenate([error, full[1:][held] / self._priors[held]])

    def scatter_N(self, rows: Array, theta: Array) -> float:
        """Standard deviation of the noise before the filter, by the residuals."""
        error = rows[:, PARAMETERS] - rows[:, :PARAMETERS] @ self.full(theta)
        return float(np.sqrt(np.mean(error**2) / self._noise_gain))

    def full(self, theta: Array) -> Array:
        """All parameters (5,) from the estimated ones; 0 for the others."""
        full = np.zeros(PARAMETERS)
        full[self._active] = theta
        return full

    def deviations(self, rows: Array, theta: Array) -> Array:
        """Standard deviations (5,) by the information of rows and priors; 0 for parameters not estimated."""
        a = rows[:, :PARAMETERS][:, self._active] / max(self.scatter_N(rows, theta), 1e-9)
        information = a.T @ a
        held = self._active[1:]
        information[1:, 1:] += np.diag(1.0 / self._priors[held] ** 2)
        result = np.zeros(PARAMETERS)
        result[self._active] = np.sqrt(np.diag(np.linalg.pinv(information)))
        return result


class FittedToWindow:
    """Base of estimators that are fitted to the rows of a window at intervals."""

    def __init__(self, config: LmConfig | GlobalConfig, plant: Plant) -> None:
        self._also = tuple(config.also)
        self._growth_pct_per_s = config.hold_growth_pct_per_s
        self._reference_Pa = plant.youngs_modulus_Pa
        self._window = RowWindow(plant, config.window_s, config.torque_noise_Nm, prior_deviations(config.also))
        deviation_Pa = 0.01 * config.initial_deviation_pct * plant.youngs_modulus_Pa
        self._estimate = Estimate(plant.youngs_modulus_Pa, deviation_Pa)

    def rebase(self, change_Pa: float) -> None:
        """Shift E of the window's rows."""
        self._window.rebase(change_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Keep the last result."""
        self._window.interrupt()
        self._estimate = held(self._estimate, self._growth_pct_per_s, duration_s)
        return self._estimate

    def _take(self, theta: Array, deviations: Array) -> None:
        """Set the estimate from parameters (5,) of a `RowWindow` and their deviations (5,)."""
        self._estimate = Estimate(
            float(theta[0]) * self._reference_Pa,
            float(deviations[0]) * self._reference_Pa,
            nuisances(self._also, theta[1:].tolist(), deviations[1:].tolist()),
        )
