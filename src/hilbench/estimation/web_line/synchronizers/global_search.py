"""Differential evolution on a window of the filtered balance: finds E without a first guess.

It takes tens of milliseconds, so it runs in a thread outside the cyclic path, and its result is used a fixed number of
cycles after the end of its window: a run in lockstep gives the same estimates on every machine. A later result is
waited for in lockstep's own time, or comes a window later.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.web_line.config import GlobalConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.window import FittedToWindow

#: Bounds of a nuisance, in prior deviations.
_NUISANCE_RANGE = 4.0


class GlobalSynchronizer(FittedToWindow):
    """Stochastic search of E over a bounded range, window after window."""

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
