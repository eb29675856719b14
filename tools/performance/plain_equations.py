"""The one-span model without effects, written down in plain Python: what the kernel stands beside.

Per drive sample: the velocity PI of both drives, then one Runge-Kutta step, or scipy's `solve_ivp`, of x and v of both
rollers and the unstretched length in the span; the torques follow their commands in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters

State = list[float]


class PlainLine:
    """Two drives, two rollers, one span; set points in m/s at the web."""

    def __init__(self, model: ModelParameters) -> None:
        drives = model.drives
        assert drives is not None
        self._mass = [model.mass_kg(axis) for axis in (1, 2)]
        self._ratio = [model.motor_rad_per_m(axis) for axis in (1, 2)]
        self._loaded = [float(model.carries_web_load(axis)) for axis in (1, 2)]
        self._kp = [per_item(drives.velocity_kp_Nm_s_per_rad, axis) for axis in (1, 2)]
        self._ki = [per_item(drives.velocity_ki_Nm_per_rad, axis) for axis in (1, 2)]
        self._limit = [per_item(drives.torque_limit_Nm, axis) for axis in (1, 2)]
        self._current_s = per_item(drives.current_loop_time_constant_s, 1)
        self._period_s = drives.sample_time_s
        self._stiffness_N = model.stiffness_N(1)
        self._length_m = model.span_length_m(1)
        self._strain_prev = model.upstream_strain
        self._f_prev_N = model.upstream_stiffness_N * model.upstream_strain
        self._f_next_N = model.boundary.downstream_tension_N
        self.y: State = [0.0, 0.0, 0.0, 0.0, self._length_m / (1.0 + self._strain_prev)]
        self._integral = [0.0, 0.0]
        self._torque = [0.0, 0.0]
        self._command = [0.0, 0.0]

    @property
    def tension_N(self) -> float:
        """Of the span."""
        return max(self._stiffness_N * (self._length_m / self.y[4] - 1.0), 0.0)

    def rates(self, t_s: float, y: Any) -> State:
        """Derivatives, `t_s` after the drives' sample."""
        left = exp(-t_s / self._current_s)
        stretch = self._length_m / y[4]
        tension = max(self._stiffness_N * (stretch - 1.0), 0.0)
        web = (tension - self._f_prev_N, self._f_next_N - tension)
        a = []
        for k in (0, 1):
            torque = self._command[k] + (self._torque[k] - self._command[k]) * left
            a.append((self._ratio[k] * torque + self._loaded[k] * web[k]) / self._mass[k])
        return [y[2], y[3], a[0], a[1], y[2] / (1.0 + self._strain_prev) - y[3] / stretch]

    def _sample(self, setpoints: Sequence[float]) -> None:
        for k in (0, 1):
            error = self._ratio[k] * (setpoints[k] - self.y[2 + k])
            integral = self._integral[k] + self._ki[k] * error * self._period_s
            wanted = self._kp[k] * error + integral
            command = min(max(wanted, -self._limit[k]), self._limit[k])
            if wanted != command and (wanted - command) * error > 0.0:
                integral = min(max(self._integral[k], -self._limit[k]), self._limit[k])
            self._integral[k], self._command[k] = integral, command

    def _settle_torques(self) -> None:
        left = exp(-self._period_s / self._current_s)
        for k in (0, 1):
            self._torque[k] = self._command[k] + (self._torque[k] - self._command[k]) * left

    def step(self, setpoints: Sequence[float]) -> None:
        """One sample time by the classical Runge-Kutta method."""
        self._sample(setpoints)
        h, y = self._period_s, self.y
        k1 = self.rates(0.0, y)
        k2 = self.rates(0.5 * h, [a + 0.5 * h * b for a, b in zip(y, k1, strict=True)])
        k3 = self.rates(0.5 * h, [a + 0.5 * h * b for a, b in zip(y, k2, strict=True)])
        k4 = self.rates(h, [a + h * b for a, b in zip(y, k3, strict=True)])
        self.y = [a + h / 6.0 * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(y, k1, k2, k3, k4, strict=True)]
        self._settle_torques()

    def step_with_scipy(self, setpoints: Sequence[float]) -> None:
        """One sample time by scipy, with tolerances that the Runge-Kutta step keeps as well."""
        self._sample(setpoints)
        found = solve_ivp(self.rates, (0.0, self._period_s), self.y, method="RK45", rtol=1e-8, atol=1e-10)
        self.y = [float(value) for value in np.asarray(found.y)[:, -1]]
        self._settle_torques()
