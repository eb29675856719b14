"""Differential evolution on a window of the filtered balance: finds E without a first guess.

It takes tens of milliseconds, so it runs in a thread outside the cyclic path, and its result is used a fixed number of
cycles after the end of its window: a run in lockstep gives the same estimates on every machine. A later result is
waited for in lockstep's own time, or comes a window later.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from hilbench.estimation.web_line.config import GlobalConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant, prior_deviations
from hilbench.estimation.web_line.synchronizers.regression import Array
from hilbench.estimation.web_line.synchronizers.window import FittedToWindow

#: Bounds of a nuisance, in prior deviations.
_NUISANCE_RANGE = 4.0


class GlobalSynchronizer(FittedToWindow):
    """Stochastic search of E over a bounded range, window after window."""

    def __init__(self, config: GlobalConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._latency_cycles, self._seed = config.latency_cycles, config.seed
        priors = prior_deviations(config.also)
        modulus = (config.lower_limit_Pa / self._reference_Pa, config.upper_limit_Pa / self._reference_Pa)
        self._bounds = [modulus] + [(-_NUISANCE_RANGE * p, _NUISANCE_RANGE * p) for p in priors if p > 0.0]
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="global-search")
        self._search: Future[tuple[Array, Array]] | None = None
        self._age = 0
        self._searches = 0

    def update(self, sample: SyncSample) -> Estimate:
        """Take one row; use a result that is due, and start the next search."""
        ready = self._window.update(sample)
        self._age += 1
        if self._search is not None and self._age >= self._latency_cycles:
            self._take(*self._search.result())
            self._search = None
        if self._search is None and ready:
            self._searches += 1
            self._search = self._pool.submit(self._run, self._window.rows(), self._seed + self._searches)
            self._age = 0
        return self._estimate

    def _run(self, rows: Array, seed: int) -> tuple[Array, Array]:
        from scipy.optimize import differential_evolution

        window = self._window

        def misfit(theta: Array) -> float:
            return float(np.sum(window.residuals(rows, theta) ** 2))

        found = differential_evolution(misfit, tuple(self._bounds), seed=seed, tol=1e-8).x
        return window.full(found), window.deviations(rows, found)
