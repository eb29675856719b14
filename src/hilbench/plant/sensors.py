"""Sensor errors: noise and resolution, reproducible for a seed whatever the block size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hilbench.block import Block
from hilbench.plant.motor_port import MotorPort


class SensorParameters(Block):
    """Sensors of one motor. Zero means perfect."""

    torque_noise_Nm: float = Field(default=0.0, ge=0.0, description="standard deviation of the measured torque")
    velocity_noise_rad_s: float = Field(default=0.0, ge=0.0, description="standard deviation of the measured velocity")
    position_noise_rad: float = Field(
        default=0.0, ge=0.0, description="standard deviation of the position, before it is counted"
    )
    encoder_rad_per_count: float = Field(default=0.0, ge=0.0, description="resolution of the encoder")


class SensorNoise:
    """Standard normal numbers of the sensors of M motors, a row (3 M,) a step: position, velocity, torque of each.

    Every quantity has its own stream, which does not depend on the `block` of steps that is drawn at once.
    """

    def __init__(self, seeds: Sequence[np.random.SeedSequence], block: int = 256) -> None:
        # Of each motor the first stream is the torque's, the last the position's.
        self._generators = [np.random.default_rng(child) for seed in seeds for child in reversed(seed.spawn(3))]
        #: Those that were drawn, (B, 3 M), and the row of the next step, (1,): B when all are used.
        self.rows, self.next = np.zeros((block, len(self._generators))), np.array([block])

    def draw(self) -> None:
        """Draw the numbers of the next B steps."""
        for column, one in enumerate(self._generators):
            self.rows[:, column] = one.standard_normal(len(self.rows))
        self.next[0] = 0

    def row(self) -> NDArray[np.float64]:
        """Numbers of the next step."""
        if self.next[0] == len(self.rows):
            self.draw()
        self.next[0] += 1
        row: NDArray[np.float64] = self.rows[self.next[0] - 1].copy()
        return row


class Sensors:
    """Measured torque, velocity and position of one motor's sensors, each with a standard normal number."""

    def __init__(self, parameters: SensorParameters) -> None:
        self._torque_noise_Nm = parameters.torque_noise_Nm
        self._velocity_noise_rad_s = parameters.velocity_noise_rad_s
        self._position_noise_rad = parameters.position_noise_rad
        self._rad_per_count = parameters.encoder_rad_per_count

    @property
    def figures(self) -> tuple[float, float, float, float]:
        """Standard deviations of position, velocity and torque, and the encoder's increment (0: none), in rad."""
        return self._position_noise_rad, self._velocity_noise_rad_s, self._torque_noise_Nm, self._rad_per_count

    def torque_Nm(self, true: float, number: float) -> float:
        """Measured torque."""
        return true + self._torque_noise_Nm * number

    def velocity_rad_s(self, true: float, number: float) -> float:
        """Measured velocity."""
        return true + self._velocity_noise_rad_s * number

    def position_rad(self, true: float, number: float) -> float:
        """Measured position: noise, then whole counts."""
        position = true + self._position_noise_rad * number
        count = self._rad_per_count
        return round(position / count) * count if count > 0.0 else position


def show(ports: Sequence[MotorPort], sensors: Sequence[Sensors], noise: SensorNoise) -> None:
    """Apply the sensors' errors to each port's exact feedback at this step."""
    numbers = iter(noise.row().tolist())
    for port, shown in zip(ports, sensors, strict=True):
        port.position_rad = shown.position_rad(port.position_rad, next(numbers))
        port.velocity_rad_s = shown.velocity_rad_s(port.velocity_rad_s, next(numbers))
        port.torque_Nm = shown.torque_Nm(port.torque_Nm, next(numbers))
