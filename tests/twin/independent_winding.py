"""An unwinder, a press and a rewinder by real radii and angles, written apart from the product: for its twin to follow.

Unstretched length in a span: its rate is r1·w1/(1 + e1) - r2·w2/(1 + e2), e of the span that web comes from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi

import numpy as np
from tests.twin.speed_driven import SpeedDriven

from hilbench.plant.motor_port import MotorPort

Array = np.ndarray
_GROWS, _WINDS = np.array([-1.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.0])


@dataclass
class IndependentWinding(SpeedDriven):
    """`radii_m` (3,): at the start; `inertia_kg_m2` (3,) of the empty rollers; `held`: the drives hold the web from the
    start, and do not give way to it at first; `strained` (2,): as many times as the wound web at the start; `slip`
    (3,): share by which the web is slower than what it runs over."""

    radii_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float] = (0.6, 0.7, 0.6)
    lengths_m: tuple[float, float] = (2.0, 3.0)
    modulus_Pa: float | Array = 2e8
    thickness_m: float = 1e-3
    width_m: float = 0.5
    density_kg_m3: float = 300.0
    core_m: float = 0.05
    wound_strain: float = 8e-4
    gear: float = 5.0
    rotor_kg_m2: float = 0.001
    kp: float = 1.5
    ki: float = 30.0
    held: bool = False
    strained: tuple[float, float] = (1.0, 1.0)
    slip: Array = field(default_factory=lambda: np.zeros(3))
    ports: list[MotorPort] = field(default_factory=lambda: [MotorPort() for _ in range(3)])
    STEPS = 2

    def __post_init__(self) -> None:
        self._lengths_m, self._at_first_m = np.array(self.lengths_m), np.asarray(self.radii_m)
        self._empty_kg_m2 = np.asarray(self.inertia_kg_m2) + self.gear**2 * self.rotor_kg_m2
        self._around, self._before = np.zeros(4), np.zeros(3)
        unstretched = self._lengths_m / (1.0 + self.wound_strain * np.array(self.strained))
        self._begin(np.concatenate([np.zeros(6), unstretched]))  # angles, speeds, unstretched lengths
        if self.held:
            pulls = np.concatenate([[0.0], self._tensions(unstretched), [0.0]])
            self._integral = -np.asarray(self.radii_m) * (pulls[1:] - pulls[:-1]) / self.gear
            self._torque = self._integral.copy()
        self._show()

    def _radii(self, angles: Array) -> Array:
        return self._at_first_m + _GROWS * self.thickness_m * angles / (2.0 * pi)

    def _tensions(self, unstretched: Array) -> Array:
        return self.modulus_Pa * self.thickness_m * self.width_m * (self._lengths_m / unstretched - 1.0)

    def _rates(self, y: Array) -> Array:
        angles, speeds, unstretched = y[:3], y[3:6], y[6:]
        radii, pulls, strains = self._radii(angles), self._around, self._before
        pulls[1:3] = self._tensions(unstretched)
        wound = 0.5 * pi * self.density_kg_m3 * self.width_m * (radii**4 - self.core_m**4) * _WINDS
        strains[0], strains[1:] = self.wound_strain, self._lengths_m / unstretched - 1.0
        carried = radii * speeds * (1.0 - self.slip) / (1.0 + strains)
        rates = np.empty_like(y)
        rates[:3] = speeds
        rates[3:6] = (self.gear * self._torque + radii * (pulls[1:] - pulls[:-1])) / (self._empty_kg_m2 + wound)
        rates[6:] = carried[:-1] - carried[1:]
        return rates

    def _motors(self) -> tuple[Array, Array]:
        return self.gear * self._y[:3], self.gear * self._y[3:6]

    def outputs(self) -> dict[str, float]:
        """Radii and tensions."""
        radii, tensions = self._radii(self._y[:3]), self._tensions(self._y[6:])
        of_reels = {"r_unwinder_m": float(radii[0]), "r_rewinder_m": float(radii[2])}
        return of_reels | {f"F{k}_N": float(value) for k, value in enumerate(tensions, 1)}
