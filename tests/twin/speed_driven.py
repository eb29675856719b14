"""PI drives that keep speeds, sampled once in a millisecond, which push without delay: of plants written apart from the
product."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from hilbench.plant.motor_port import MotorPort

Array = np.ndarray
_SAMPLE_S = 1e-3


class SpeedDriven(ABC):
    """A plant of state `_y` whose motors have the torques `_torque`, N·m; one port for each."""

    ports: Sequence[MotorPort]
    kp: float
    ki: float
    STEPS: int  #: of Runge and Kutta in a sample

    def _begin(self, y: Array) -> None:
        self._y = y
        self._integral, self._torque = np.zeros(len(self.ports)), np.zeros(len(self.ports))

    @abstractmethod
    def _rates(self, y: Array) -> Array:
        """Of the state, 1/s."""

    @abstractmethod
    def _motors(self) -> tuple[Array, Array]:
        """Angles, rad, and speeds, rad/s."""

    def step(self, duration_s: float) -> None:
        """Go on with the ports' set points."""
        h = _SAMPLE_S / self.STEPS
        for _ in range(round(duration_s / _SAMPLE_S)):
            off = np.array([port.setpoint for port in self.ports]) - self._motors()[1]
            self._integral += self.ki * off * _SAMPLE_S
            self._torque = self.kp * off + self._integral
            for _ in range(self.STEPS):
                a = self._rates(self._y)
                b = self._rates(self._y + 0.5 * h * a)
                c = self._rates(self._y + 0.5 * h * b)
                d = self._rates(self._y + h * c)
                self._y = self._y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        self._show()

    def _show(self) -> None:
        for port, angle, speed, torque in zip(self.ports, *self._motors(), self._torque, strict=True):
            port.position_rad, port.velocity_rad_s, port.torque_Nm = float(angle), float(speed), float(torque)
