"""Extended Kalman filter of motion, E and nuisance parameters; the process noise of E adapts itself.

The innovations of a correct filter are white. A change of E shows as a run of innovations of one sign: the square of
their short mean, beyond what white noise gives it, opens the random walk of E. Until it has closed again the nuisance
parameters keep their values from before the run.
"""

from __future__ import annotations

from collections import deque
from math import sqrt

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.web_line.config import EkfConfig
from hilbench.estimation.web_line.synchronizers import filters, kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.filters import Filters

#: Memory of the innovations' short mean, in samples; its variance for white ones is 1/(2·8).
_MEMORY = 8.0
#: The mean's square beyond so many variances opens the random walk, fully at twice as many.
_FROM = 20.0


class EkfSynchronizer(Filters):
    """Extended Kalman filter; state as in `kalman`."""

    def __init__(self, config: EkfConfig, plant: Plant) -> None:
        super().__init__(config, plant, (0.0, 0.0, 1))
        self._config, bank = config, self.arrays.bank
        self._z, self._p, self._work = bank.z[:, 0], bank.p[:, :, 0], bank.work
        self._mean = 0.0
        self._nuisances_before: deque[Array] = deque(maxlen=2 * round(_MEMORY))

    def update(self, sample: SyncSample) -> Estimate:
        """Predict and correct."""
        c = self._config
        if self.take(filters.FILL, sample):
            opened = min(max(self._mean**2 * 2.0 * _MEMORY / _FROM - 1.0, 0.0), 1.0)
            walk = 0.01 * (c.drift_pct_per_sqrt_s + opened * c.jump_pct_per_sqrt_s)
            self.inputs["parameter_variance_per_s"] = walk**2
            self.act(filters.STEP)
            before, beside = self._nuisances_before, self._z[kalman.OFFSET :]
            if opened > 0.0 and before:
                beside[:] = before[0]
            else:
                before.append(beside.copy())
            normalized = self._work.item(kalman.SIZE + 1) / sqrt(self._work.item(kalman.SIZE + 2))
            self._mean += (min(max(normalized, -5.0), 5.0) - self._mean) / _MEMORY
        return self.estimate

    @property
    def estimate(self) -> Estimate:
        """Estimate of the last cycle."""
        return self._estimate_by(self._z, np.sqrt(np.diag(self._p)))
