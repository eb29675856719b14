"""Response of drives' torques to loads: PI velocity loops that keep their rollers' speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilbench.compiled import CUBE, FLAG, MATRIX, Vector, entry_point


@entry_point(CUBE, CUBE, MATRIX, MATRIX, MATRIX, MATRIX, FLAG)
def _answer(
    states: Vector, transition: Vector, inputs: Vector, gains: Vector, loads: Vector, torques: Vector, continues: bool
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
        self._cycle_s = cycle_s
        self._states = np.zeros((len(kp), 2, loads))  # speed, and its integral, of each drive by each load
        self._transition, self._input = np.zeros((len(kp), 2, 2)), np.zeros((len(kp), 2))
        self._none = np.zeros((len(kp), loads))
        #: Torque of each drive by each load (N, loads).
        self.torques_Nm = np.zeros((len(kp), loads))

    def reset(self) -> None:
        """Reset to rest without load."""
        self._states[:] = self.torques_Nm[:] = 0.0

    def go_on_from(self, other: DriveResponse) -> None:
        """Copy the state of a response of the same drives and loads."""
        self._states[:] = other._states
        self._show()

    def set_inertia(self, inertia_kg_m2: Vector) -> None:
        """Set the inertia of each drive with its load, at the motor (N,). Trapezoidal rule, stable for every loop."""
        half = np.zeros_like(self._transition)
        half[:, 0] = -0.5 * self._cycle_s * self._gains / inertia_kg_m2[:, None]
        half[:, 1, 0] = 0.5 * self._cycle_s
        back = np.linalg.inv(np.eye(2) - half)
        self._transition[:] = back @ (np.eye(2) + half)
        self._input[:] = back[:, :, 0] * (self._cycle_s / inertia_kg_m2)[:, None]

    def step(self, loads_Nm: Vector) -> None:
        """Step a cycle with these loads (N, loads), forward."""
        _answer(self._states, self._transition, self._input, self._gains, loads_Nm, self.torques_Nm, True)

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
        _answer(self._states, self._transition, self._input, self._gains, self._none, self.torques_Nm, False)
