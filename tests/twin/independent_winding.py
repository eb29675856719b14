"""An unwinder, a press and a rewinder by real radii and angles, written apart from the product: for its twin to follow.

Unstretched length in a span: its rate is r1·w1/(1 + e1) - r2·w2/(1 + e2), e of the span that web comes from; PI drives
at the motors, sampled once in a millisecond, push without delay.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi

import numpy as np

from hilbench.plant.motor_port import MotorPort

Array = np.ndarray
_SAMPLE_S = 1e-3
_STEPS = 2  # of Runge and Kutta in a sample


@dataclass
class IndependentWinding:
    """`radii_m` (3,): at the start; `inertia_kg_m2` (3,) of the empty rollers; `held`: the drives hold the web from the
    start, and do not give way to it at first; `slip` (3,): share by which the web is slower than what it runs over."""

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
    slip: Array = field(default_factory=lambda: np.zeros(3))
    ports: list[MotorPort] = field(default_factory=lambda: [MotorPort() for _ in range(3)])

    def __post_init__(self) -> None:
        unstretched = np.array(self.lengths_m) / (1.0 + self.wound_strain)
        self._y = np.concatenate([np.zeros(6), unstretched])  # angles, speeds, unstretched lengths
        self._integral = np.zeros(3)
        self._torque = np.zeros(3)
        if self.held:
            pulls = np.concatenate([[0.0], self._tensions(unstretched), [0.0]])
            self._integral = -np.asarray(self.radii_m) * (pulls[1:] - pulls[:-1]) / self.gear
            self._torque = self._integral.copy()
        self._show()

    def _radii(self, angles: Array) -> Array:
        grow = np.array([-1.0, 0.0, 1.0]) * self.thickness_m * angles / (2.0 * pi)
        return np.asarray(self.radii_m) + grow

    def _tensions(self, unstretched: Array) -> Array:
        return self.modulus_Pa * self.thickness_m * self.width_m * (np.array(self.lengths_m) / unstretched - 1.0)

    def _rates(self, y: Array) -> Array:
        angles, speeds, unstretched = y[:3], y[3:6], y[6:]
        radii, pulls = self._radii(angles), np.concatenate([[0.0], self._tensions(unstretched), [0.0]])
        wound = 0.5 * pi * self.density_kg_m3 * self.width_m * (radii**4 - self.core_m**4) * np.array([1.0, 0.0, 1.0])
        inertia = np.asarray(self.inertia_kg_m2) + self.gear**2 * self.rotor_kg_m2 + wound
        turned = (self.gear * self._torque + radii * (pulls[1:] - pulls[:-1])) / inertia
        strains = np.concatenate([[self.wound_strain], np.array(self.lengths_m) / unstretched - 1.0])
        carried = radii * speeds * (1.0 - self.slip) / (1.0 + strains)
        return np.concatenate([speeds, turned, carried[:-1] - carried[1:]])

    def step(self, duration_s: float) -> None:
        """Go on with the ports' set points."""
        for _ in range(round(duration_s / _SAMPLE_S)):
            wanted = np.array([port.setpoint for port in self.ports])
            off = wanted - self.gear * self._y[3:6]
            self._integral += self.ki * off * _SAMPLE_S
            self._torque = self.kp * off + self._integral
            for _ in range(_STEPS):
                h = _SAMPLE_S / _STEPS
                a = self._rates(self._y)
                b = self._rates(self._y + 0.5 * h * a)
                c = self._rates(self._y + 0.5 * h * b)
                d = self._rates(self._y + h * c)
                self._y = self._y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        self._show()

    def _show(self) -> None:
        for axis, port in enumerate(self.ports):
            port.position_rad = float(self.gear * self._y[axis])
            port.velocity_rad_s = float(self.gear * self._y[3 + axis])
            port.torque_Nm = float(self._torque[axis])

    def outputs(self) -> dict[str, float]:
        """Radii and tensions."""
        radii, tensions = self._radii(self._y[:3]), self._tensions(self._y[6:])
        of_reels = {"r_unwinder_m": float(radii[0]), "r_rewinder_m": float(radii[2])}
        return of_reels | {f"F{k}_N": float(value) for k, value in enumerate(tensions, 1)}
