"""The balance as a linear regression without derivatives: both sides through one low-pass filter.

    m·s²/(1+sT)²·x2 = 1/(1+sT)²·(force − F − R)

so y = m·(filtered acceleration) − filtered force = −E·h_f − (i/r)·b_f − c·v_f − d·sign_f + noise, where a state
variable filter gives the acceleration from positions alone. Rows of it are what `rls`, `lm` and `global` fit.
"""

from __future__ import annotations

from math import exp

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import MATRIX, REAL, VECTOR, entry_point
from hilbench.estimation.web_line.synchronizers.base import Plant, SyncSample

#: Time constant of the filter: above the cycle, below the loops of the drives.
FILTER_S = 0.004
#: Columns of a row: regressors of the parameters E/E0, offset, viscous, dry, mass, then the right-hand side; newtons.
PARAMETERS = 5
_INPUTS = 6
#: Time constants until the filter's initial value has faded.
_SETTLED = 12.0


@entry_point(MATRIX, VECTOR, REAL, REAL, REAL, VECTOR)
def _filter(state: Array, inputs: Array, decay: float, mass: float, cycle_s: float, row: Array) -> None:
    """Two low passes in series, y = (1-d)·u + d·y', of [x − x0, force, web, speed, sign, 1]; state (2, inputs).

    u − y is the low pass of u's difference, times d/(1-d): the acceleration comes from what the filters hold.
    """
    for j in range(inputs.shape[0]):
        state[0, j] = inputs[j] + (state[0, j] - inputs[j]) * decay
        state[1, j] = state[0, j] + (state[1, j] - state[0, j]) * decay
    gain = (1.0 - decay) / (decay * cycle_s)
    acceleration = (inputs[0] - 2.0 * state[0, 0] + state[1, 0]) * gain * gain
    row[0] = state[1, 2]
    row[1] = state[1, 5]
    row[2] = state[1, 3]
    row[3] = state[1, 4]
    row[4] = mass * acceleration
    row[5] = state[1, 1] - mass * acceleration


class RegressionRows:
    """Regression rows, one a cycle; `row` (6,) is valid when `update` returns True, after the filter has settled."""

    def __init__(self, plant: Plant) -> None:
        self.row = np.zeros(PARAMETERS + 1)
        self._plant = plant
        self._state = np.zeros((2, _INPUTS))
        self._before = np.zeros(_INPUTS)
        self._origin_m = 0.0
        self._count = 0

    def interrupt(self) -> None:
        """Settle the filter anew after a missing cycle."""
        self._count = 0

    def update(self, sample: SyncSample) -> bool:
        """Take one sample; True when `row` holds a valid row."""
        balance, before = sample.balance, self._before
        self._count += 1
        decay = exp(-sample.cycle_s / FILTER_S)
        # A second difference of positions is the acceleration one cycle ago: the forces are delayed by a cycle.
        if self._count == 2:
            self._origin_m = balance.x2_m
            self._state[:] = before
            self._state[:, 0] = -balance.velocity_m_s * sample.cycle_s * decay / (1.0 - decay) * np.array([1.0, 2.0])
        if self._count >= 2:
            before[0] = balance.x2_m - self._origin_m
            _filter(self._state, before, decay, self._plant.mass_kg, sample.cycle_s, self.row)
        speed = balance.velocity_m_s
        before[1] = balance.force_N
        before[2] = balance.web_per_Pa * self._plant.youngs_modulus_Pa
        before[3] = speed
        before[4] = float(np.sign(speed))
        before[5] = self._plant.force_per_torque_per_m
        return self._count * sample.cycle_s > _SETTLED * FILTER_S


def noise_gain(cycle_s: float) -> float:
    """Variance of white noise after the filter over that before it: Σ g², g = (j + 1)·(1-d)²·dʲ."""
    d = exp(-cycle_s / FILTER_S)
    return (1.0 - d) ** 4 * (1.0 + d * d) / (1.0 - d * d) ** 3
