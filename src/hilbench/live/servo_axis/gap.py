"""Torque residual of a servo axis, cheaply: the drive's torque less the one that its motion requires.

Motion and torque are means over `SHORT` cycles. The acceleration of a mean is that of its neighbours' positions, so it
is known one mean later; the torque is weighted as that weights it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hilbench.live.machine import SHORT
from hilbench.live.servo_axis.models import inertia_factor
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.inverse import required_torque_Nm

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

#: Means that the acceleration of one needs: itself, and those beside it.
_NEIGHBOURS = 2


class ShaftGap:
    """The gap of one model along a run of a servo axis, N·m at its motor."""

    def __init__(self, model: ServoAxisParameters, cycle_s: float) -> None:
        self._p = lay.pack(model)
        self._factor = inertia_factor(model, 0.0)
        self._mean_s = SHORT * cycle_s
        self.restart()

    def restart(self) -> None:
        """The next rows are not those that follow the last."""
        self._kept = np.full((_NEIGHBOURS, 2), np.nan)  # position and torque of the last means

    def use_estimate(self, estimate: Array) -> None:
        """Inertia of the shaft (1,) from now on, kg·m²."""
        self._p[lay.P_INERTIA] = estimate[0] / self._factor

    def follow(self, channels: Mapping[str, Array], known: Rows) -> Array:
        """(n // SHORT, 1): of the next rows (n,) of x1_rad and tau1_Nm; n a multiple. Each is of the mean before.

        NaN where a row is not known."""
        rows = np.column_stack([channels["x1_rad"], channels["tau1_Nm"]])
        rows = np.where(known[:, None], rows, np.nan)
        means = np.concatenate([self._kept, rows.reshape(-1, SHORT, 2).mean(axis=1)])
        self._kept = means[-_NEIGHBOURS:]
        x, torque = means.T
        speed = (x[2:] - x[:-2]) / (2.0 * self._mean_s)
        acceleration = (x[2:] - 2.0 * x[1:-1] + x[:-2]) / self._mean_s**2
        required = np.empty(len(speed))
        required_torque_Nm(self._p, x[1:-1], speed, acceleration, self._mean_s, required)
        return np.asarray((torque[1:-1] - required)[:, None])
