"""What drives' torques answer to loads: PI velocity loops that keep their rollers' speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilbench.plant.web_line.layout import Vector


class DriveResponse:
    """Of N drives, to so many loads each at once, which come once a cycle; linear, without limits and current loop.

    With inertia J: J·w' = tau + load, tau = -kp·w - ki·∫w, all at the motor.
    """

    def __init__(self, kp: Sequence[float], ki: Sequence[float], loads: int, cycle_s: float) -> None:
        self._kp, self._ki = np.array(kp), np.array(ki)
        self._cycle_s = cycle_s
        self.states = np.zeros((len(kp), 2, loads))  #: speed, and its integral, of each drive by each load
        self._transition, self._input = np.zeros((len(kp), 2, 2)), np.zeros((len(kp), 2))

    def reset(self) -> None:
        """At rest without load."""
        self.states[:] = 0.0

    def set_inertia(self, inertia_kg_m2: Sequence[float]) -> None:
        """Of each drive with what it turns, at the motor. By the trapezoidal rule, that is stable for every loop."""
        for axis, inertia in enumerate(inertia_kg_m2):
            rates = np.array([[-self._kp[axis] / inertia, -self._ki[axis] / inertia], [1.0, 0.0]])
            half = 0.5 * self._cycle_s * rates
            back = np.linalg.inv(np.eye(2) - half)
            self._transition[axis] = back @ (np.eye(2) + half)
            self._input[axis] = back @ np.array([self._cycle_s / inertia, 0.0])

    def step(self, loads_Nm: Vector) -> None:
        """A cycle with these loads (N, loads), forward."""
        self.states = self._transition @ self.states + self._input[:, :, None] * loads_Nm[:, None, :]

    @property
    def torques_Nm(self) -> Vector:
        """Of each drive by each load (N, loads)."""
        return -(self._kp[:, None] * self.states[:, 0] + self._ki[:, None] * self.states[:, 1])
