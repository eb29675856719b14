"""Sensor errors: noise and resolution, reproducible for a seed whatever the block size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hilbench.block import Block


class SensorParameters(Block):
    """Sensors of one motor. Zero means perfect."""

    torque_noise_Nm: float = Field(default=0.0, ge=0.0, description="standard deviation of the measured torque")
    velocity_noise_rad_s: float = Field(default=0.0, ge=0.0, description="standard deviation of the measured velocity")
    position_noise_rad: float = Field(
        default=0.0, ge=0.0, description="standard deviation of the position, before it is counted"
    )
    encoder_rad_per_count: float = Field(default=0.0, ge=0.0, description="resolution of the encoder")

    @property
    def figures(self) -> tuple[float, float, float, float]:
        """Standard deviations of position, velocity and torque, and the encoder's increment (0: none), in rad."""
        noise = self.position_noise_rad, self.velocity_noise_rad_s, self.torque_noise_Nm
        return (*noise, self.encoder_rad_per_count)


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
