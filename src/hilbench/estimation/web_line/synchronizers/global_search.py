"""Differential evolution on a window of the filtered balance: finds E without a first guess.

It takes tens of milliseconds, so it runs beside the cyclic path, in a thread, and its result is taken a fixed number of
cycles after its window has ended: so a run in lockstep gives the same estimates on every machine. A result that is
not there by then is waited for in lockstep's own time, or comes a window later.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from hilbench.estimation.web_line.config import GlobalConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant, held, nuisances, prior_deviations
from hilbench.estimation.web_line.synchronizers.regression import PARAMETERS, Array
from hilbench.estimation.web_line.synchronizers.window import RowWindow

#: Bounds of a nuisance, in prior deviations.
_NUISANCE_RANGE = 4.0


class GlobalSynchronizer:
    """A stochastic search over a bounded range, window after window."""

    def __init__(self, config: GlobalConfig, plant: Plant) -> None:
        self._config = config
        self._also = tuple(config.also)
        self._reference_Pa = plant.youngs_modulus_Pa
        priors = prior_deviations(config.also)
        self._window = RowWindow(plant, config.window_s, config.torque_noise_Nm, priors)
        modulus = (config.lower_limit_Pa / self._reference_Pa, config.upper_limit_Pa / self._reference_Pa)
        self._bounds = [modulus] + [(-_NUISANCE_RANGE * p, _NUISANCE_RANGE * p) for p in priors if p > 0.0]
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="global-search")
        self._search: Future[tuple[Array, Array]] | None = None
        self._age = 0
        self._searches = 0
        deviation_Pa = 0.01 * config.initial_deviation_pct * plant.youngs_modulus_Pa
        self._estimate = Estimate(plant.youngs_modulus_Pa, deviation_Pa)

    def update(self, sample: SyncSample) -> Estimate:
        """Take one row; take a result that is due, and begin the next search."""
        ready = self._window.update(sample)
        self._age += 1
        if self._search is not None and self._age >= self._config.latency_cycles:
            self._take(*self._search.result())
            self._search = None
        if self._search is None and ready:
            self._searches += 1
            self._search = self._pool.submit(self._run, self._window.rows(), self._config.seed + self._searches)
            self._age = 0
        return self._estimate

    def rebase(self, change_Pa: float) -> None:
        """Move the rows of the window."""
        self._window.rebase(change_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Keep the last result."""
        self._window.interrupt()
        self._estimate = held(self._estimate, self._config.hold_growth_pct_per_s, duration_s)
        return self._estimate

    def _run(self, rows: Array, seed: int) -> tuple[Array, Array]:
        from scipy.optimize import differential_evolution

        window = self._window

        def misfit(theta: Array) -> float:
            return float(np.sum(window.residuals(rows, theta) ** 2))

        found = differential_evolution(misfit, tuple(self._bounds), seed=seed, tol=1e-8).x
        theta = np.zeros(PARAMETERS)
        theta[window.active] = found
        return theta, window.deviations(rows, found)

    def _take(self, theta: Array, deviations: Array) -> None:
        self._estimate = Estimate(
            float(theta[0]) * self._reference_Pa,
            float(deviations[0]) * self._reference_Pa,
            nuisances(self._also, theta[1:].tolist(), deviations[1:].tolist()),
        )
