"""Extended Kalman filter of motion, E and nuisance parameters; the process noise of E adapts itself.

The innovations of a correct filter are white. A change of E shows as a run of innovations of one sign: the square of
their short mean, beyond what white noise gives it, opens the random walk of E. Until it has closed again the nuisance
parameters keep their values from before the run.
"""

from __future__ import annotations

from collections import deque
from math import sqrt

import numpy as np

from hilbench.compiled import CUBE, INDICES, MATRIX, VECTOR, entry_point
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.web_line.config import EkfConfig
from hilbench.estimation.web_line.synchronizers import kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import FilterInputs, Plant, nuisances

#: Memory of the innovations' short mean, in samples; its variance for white ones is 1/(2·8).
_MEMORY = 8.0
#: The mean's square beyond so many variances opens the random walk, fully at twice as many.
_FROM = 20.0


@entry_point(MATRIX, CUBE, VECTOR, INDICES, VECTOR, MATRIX)
def _step(z: Array, p: Array, u: Array, places: Places, g: Array, work: Array) -> None:
    """Step the filter; g (SIZE,), work (SIZE + 4, 1): scratch, which returns innovation and variance
    (`kalman.step`)."""
    kalman.step(z, p, u, places, g, work, work[z.shape[0] + 3])


class EkfSynchronizer:
    """Extended Kalman filter; state as in `kalman`."""

    def __init__(self, config: EkfConfig, plant: Plant) -> None:
        self._config = config
        self._also = tuple(config.also)
        self._reference_Pa = plant.youngs_modulus_Pa
        self._inputs = FilterInputs(plant, config)
        self._places = kalman.places_of(self._inputs.priors)
        self._z = np.zeros((kalman.SIZE, 1))
        self._p = np.zeros((kalman.SIZE, kalman.SIZE, 1))
        self._work, self._g = np.zeros((kalman.SIZE + 4, 1)), np.zeros(kalman.SIZE)
        self._started = False
        self._mean = 0.0
        self._nuisances_before: deque[Array] = deque(maxlen=2 * round(_MEMORY))

    def update(self, sample: SyncSample) -> Estimate:
        """Predict and correct."""
        inputs, c = self._inputs, self._config
        if not self._started:
            deviation = 0.01 * c.initial_deviation_pct
            kalman.new_filter(self._z, self._p, 0, sample.balance.x2_m, deviation, inputs.priors)
            self._started = True
        if inputs.update(sample):
            opened = min(max(self._mean**2 * 2.0 * _MEMORY / _FROM - 1.0, 0.0), 1.0)
            walk = 0.01 * (c.drift_pct_per_sqrt_s + opened * c.jump_pct_per_sqrt_s)
            inputs.u[kalman.E_VARIANCE_PER_S] = walk**2
            _step(self._z, self._p, inputs.u, self._places, self._g, self._work)
            self._keep_beside(opened)
            normalized = self._work.item(kalman.SIZE + 1) / sqrt(self._work.item(kalman.SIZE + 2))
            self._mean += (min(max(normalized, -5.0), 5.0) - self._mean) / _MEMORY
        return self._estimate()

    def _keep_beside(self, opened: float) -> None:
        before, beside = self._nuisances_before, self._z[kalman.OFFSET :, 0]
        if opened > 0.0 and before:
            beside[:] = before[0]
        else:
            before.append(beside.copy())

    def rebase(self, change_Pa: float) -> None:
        """Shift E."""
        self._z[kalman.E, 0] += change_Pa / self._reference_Pa

    def hold(self, duration_s: float) -> Estimate:
        """Widen E (random walk); reset position and velocity."""
        self._inputs.interrupt()
        p, walk = self._p, 0.01 * self._config.hold_growth_pct_per_s
        p[kalman.E, kalman.E, 0] += walk**2 * duration_s
        kalman.lose_motion(p)
        return self._estimate()

    def _estimate(self) -> Estimate:
        z, deviations = self._z[:, 0], np.sqrt(np.diag(self._p[:, :, 0]))
        return Estimate(
            float(z[kalman.E]) * self._reference_Pa,
            float(deviations[kalman.E]) * self._reference_Pa,
            nuisances(self._also, z[kalman.OFFSET :].tolist(), deviations[kalman.OFFSET :].tolist()),
        )
