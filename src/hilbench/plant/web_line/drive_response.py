"""Response of drives' torques to loads: PI velocity loops that keep their rollers' speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hilbench.compiled import CUBE, FLAG, MATRIX, Reals2, Reals3, Vector, entry_point


class ResponseArrays(NamedTuple):
    """Speed and its integral of each drive by each load (N, 2, L), what is left of them and added by a load in a cycle,
    gains (N, 2), and torques (N, L)."""

    states: Reals3
    transition: Reals3
    inputs: Reals2
    gains: Reals2
    torques: Reals2


@entry_point(CUBE, CUBE, MATRIX, MATRIX, MATRIX, MATRIX, FLAG, allocates=False)
def answer(
    states: Vector, transition: Vector, inputs: Vector, gains: Vector, torques: Vector, loads: Vector, continues: bool
) -> None:
    """Torques (N, L); `continues`: after a cycle with these loads (N, L)."""
    for i in range(states.shape[0]):
        for j in range(states.shape[2]):
            speed, integral = states[i, 0, j], states[i, 1, j]
            if continues:
                load = loads[i, j]
                states[i, 0, j] = transition[i, 0, 0] * speed + transition[i, 0, 1] * integral + inputs[i, 0] * load
                states[i, 1, j] = transition[i, 1, 0] * speed + transition[i, 1, 1] * integral + inputs[i, 1] * load
            torques[i, j] = -(gains[i, 0] * states[i, 0, j] + gains[i, 1] * states[i, 1, j])


class DriveResponse:
    """Linear torque response of N drives to several loads each, updated once a cycle; without limits and current loop.

    With inertia J: J·w' = tau + load, tau = -kp·w - ki·∫w, all at the motor.
    """

    def __init__(self, kp: Sequence[float], ki: Sequence[float], loads: int, cycle_s: float) -> None:
        self._gains = np.array([kp, ki]).T.copy()
        self.cycle_s = cycle_s
        self._states = np.zeros((len(kp), 2, loads))
        self._transition, self._input = np.zeros((len(kp), 2, 2)), np.zeros((len(kp), 2))
        self._none = np.zeros((len(kp), loads))
        #: Torque of each drive by each load (N, loads).
        self.torques_Nm = np.zeros((len(kp), loads))
        self.arrays = ResponseArrays(self._states, self._transition, self._input, self._gains, self.torques_Nm)

    def reset(self) -> None:
        """Reset to rest without load."""
        self._states[:] = self.torques_Nm[:] = 0.0

    def set_inertia(self, inertia_kg_m2: Vector) -> None:
        """Set the inertia of each drive with its load, at the motor (N,). Trapezoidal rule, stable for every loop."""
        half = np.zeros_like(self._transition)
        half[:, 0] = -0.5 * self.cycle_s * self._gains / inertia_kg_m2[:, None]
        half[:, 1, 0] = 0.5 * self.cycle_s
        back = np.linalg.inv(np.eye(2) - half)
        self._transition[:] = back @ (np.eye(2) + half)
        self._input[:] = back[:, :, 0] * (self.cycle_s / inertia_kg_m2)[:, None]

    def step(self, loads_Nm: Vector) -> None:
        """Step a cycle with these loads (N, loads), forward."""
        answer(*self.arrays, loads_Nm, True)

    def add(self, load: int, shares: Vector) -> None:
        """Add shares of the responses to all previous loads to that of `load`."""
        self._states[:, :, load] += self._states[:, :, :load] @ shares
        self._show()

    def turn(self, matrix: Vector) -> None:
        """Change of basis of the first n load channels: L ← L·matrix, `matrix` (n, n)."""
        count = len(matrix)
        self._states[:, :, :count] = self._states[:, :, :count] @ matrix
        self._show()

    def answer_from(self, cycles: int, loads: Sequence[int], loads_Nm: Vector) -> None:
        """Recompute the response to some loads (by number), as if applied `cycles` ago and 0 before."""
        before = self._states.copy()
        self._states[:, :, loads] = 0.0
        for _ in range(cycles):
            self.step(loads_Nm)
        before[:, :, loads] = self._states[:, :, loads]
        self._states[:] = before
        self._show()

    def _show(self) -> None:
        answer(*self.arrays, self._none, False)
