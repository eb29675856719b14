"""A line of driven rollers over which its web creeps, by angles, written apart from the product: for its twin to
follow.

What goes over a roller comes, forward, from the span before it, in reverse from that behind it, with the strain of
that; it creeps the way that it is pulled: as fast as the roller, less c·|v|·(F before - F behind).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from tests.twin.speed_driven import SpeedDriven

from hilbench.plant.motor_port import MotorPort

Array = np.ndarray


@dataclass
class IndependentSpans(SpeedDriven):
    """`lengths_m` (K,), `creep_per_N` (K,) over the roller behind each span; at the first roller nothing pulls, what
    enters there is strained as `upstream_N` asks."""

    lengths_m: tuple[float, ...]
    creep_per_N: tuple[float, ...]
    upstream_N: float
    downstream_N: float
    modulus_Pa: float = 8.7e9
    section_m2: float = 0.5 * 65e-6
    radius_m: float = 0.2
    inertia_kg_m2: float = 1.167 + 5.0**2 * 0.001
    gear: float = 5.0
    kp: float = 1.5
    ki: float = 30.0
    ports: list[MotorPort] = field(init=False)
    STEPS = 2

    def __post_init__(self) -> None:
        n = len(self.lengths_m) + 1
        self.ports = [MotorPort() for _ in range(n)]
        self.stiffness_N = self.modulus_Pa * self.section_m2
        self._lengths_m, self._creeps_per_N = np.array(self.lengths_m), np.array([0.0, *self.creep_per_N])
        self._around = np.array([self.upstream_N, *self.lengths_m, self.downstream_N])
        unstretched = self._lengths_m / (1.0 + self.upstream_N / self.stiffness_N)
        self._begin(np.concatenate([np.zeros(2 * n), unstretched]))  # angles, speeds, unstretched lengths
        self._show()

    def parameter(self, name: str) -> float:
        """E, of any span."""
        return self.modulus_Pa

    def elasticity_factor(self, span: int) -> float:
        """No effect acts on E."""
        return 1.0

    @property
    def tension_N(self) -> Array:
        """Of each span."""
        return self._tensions(self._y[2 * len(self.ports) :])

    def _tensions(self, unstretched: Array) -> Array:
        return self.stiffness_N * (self._lengths_m / unstretched - 1.0)

    def _rates(self, y: Array) -> Array:
        n = len(self.ports)
        speeds, around = y[n : 2 * n], self._around
        around[1:-1] = self._tensions(y[2 * n :])
        pulls = around[1:] - around[:-1]
        pulls[0] = 0.0
        surface = self.radius_m * speeds
        creeps = surface + np.abs(surface) * self._creeps_per_N * pulls
        strains = around / self.stiffness_N
        passes = creeps / (1.0 + np.where(surface >= 0.0, strains[:-1], strains[1:]))
        rates = np.empty_like(y)
        rates[:n] = speeds
        rates[n : 2 * n] = (self.gear * self._torque + self.radius_m * pulls) / self.inertia_kg_m2
        rates[2 * n :] = passes[:-1] - passes[1:]
        return rates

    def _motors(self) -> tuple[Array, Array]:
        n = len(self.ports)
        return self.gear * self._y[:n], self.gear * self._y[n : 2 * n]
