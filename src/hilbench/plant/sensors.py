"""What sensors add to the truth: noise and resolution, the same for one seed whatever the block size."""

from __future__ import annotations

import numpy as np
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


class Gaussian:
    """Standard normal numbers, drawn in blocks from a generator of its own."""

    def __init__(self, generator: np.random.Generator, block: int = 1024):
        self._generator = generator
        self._block = block
        self._numbers: list[float] = []
        self._next = 0

    def next(self) -> float:
        """The next number of the stream; the stream does not depend on the block size."""
        at = self._next
        if at == len(self._numbers):
            self._numbers = self._generator.standard_normal(self._block).tolist()
            at = 0
        self._next = at + 1
        return self._numbers[at]


class Sensors:
    """Torque, velocity and position as one motor's sensors show them. Every quantity has its own stream."""

    def __init__(self, parameters: SensorParameters, seed: np.random.SeedSequence, block: int = 1024):
        self._torque_noise_Nm = parameters.torque_noise_Nm
        self._velocity_noise_rad_s = parameters.velocity_noise_rad_s
        self._position_noise_rad = parameters.position_noise_rad
        self._rad_per_count = parameters.encoder_rad_per_count
        streams = [Gaussian(np.random.default_rng(child), block) for child in seed.spawn(3)]
        self._torque, self._velocity, self._position = streams

    @property
    def figures(self) -> tuple[float, float, float, float]:
        """Standard deviations of position, velocity and torque, and what the encoder counts (0: nothing), in rad."""
        return self._position_noise_rad, self._velocity_noise_rad_s, self._torque_noise_Nm, self._rad_per_count

    def noise(self) -> tuple[float, float, float]:
        """The next normal numbers of position, velocity and torque, for who adds them to the truth."""
        return self._position.next(), self._velocity.next(), self._torque.next()

    def torque_Nm(self, true: float) -> float:
        """Measured torque."""
        return true + self._torque_noise_Nm * self._torque.next()

    def velocity_rad_s(self, true: float) -> float:
        """Measured velocity."""
        return true + self._velocity_noise_rad_s * self._velocity.next()

    def position_rad(self, true: float) -> float:
        """Measured position: noise, then whole counts."""
        position = true + self._position_noise_rad * self._position.next()
        count = self._rad_per_count
        return round(position / count) * count if count > 0.0 else position
