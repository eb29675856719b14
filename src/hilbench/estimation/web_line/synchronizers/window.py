"""Methods that fit a moving window of rows of the filtered balance at intervals: least squares, and a search."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

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

#: Bounds of a nuisance in a search, in prior deviations.
_NUISANCE_RANGE = 4.0


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


class LmSynchronizer(FittedToWindow):
    """Least-squares solution of the window every few cycles, started at the previous one: Levenberg–Marquardt (scipy's
    MINPACK)."""

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


class GlobalSynchronizer(FittedToWindow):
    """Differential evolution over a bounded range, window after window: finds E without a first guess.

    It takes tens of milliseconds, so it runs in a thread outside the cyclic path, and its result is used a fixed number
    of cycles after the end of its window: a run in lockstep gives the same estimates on every machine. A later result
    is waited for in lockstep's own time, or comes a window later.
    """

    def __init__(self, config: GlobalConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._latency_cycles, self._seed = config.latency_cycles, config.seed
        modulus = (config.lower_limit_Pa / self._reference_Pa, config.upper_limit_Pa / self._reference_Pa)
        self._bounds = [modulus] + [(-_NUISANCE_RANGE * p, _NUISANCE_RANGE * p) for p in self._priors if p > 0.0]
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="global-search")
        self._search: Future[Estimate] | None = None
        self._age = 0
        self._searches = 0

    def update(self, sample: SyncSample) -> Estimate:
        """Take one row; use a result that is due, and start the next search."""
        ready = self._add(sample)
        self._age += 1
        if self._search is not None and self._age >= self._latency_cycles:
            self._estimate, self._search = self._search.result(), None
        if self._search is None and ready:
            self._searches += 1
            self._search = self._pool.submit(self._run, self._window(), self._seed + self._searches)
            self._age = 0
        return self._estimate

    def _run(self, rows: Array, seed: int) -> Estimate:
        from scipy.optimize import differential_evolution

        def misfit(theta: Array) -> float:
            return float(np.sum(self._residuals(rows, theta) ** 2))

        found = differential_evolution(misfit, tuple(self._bounds), seed=seed, tol=1e-8).x
        return self._fitted(rows, found)
