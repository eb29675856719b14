"""A rigid arm of two links that swings in the vertical plane, simulated by scipy from its equations of motion as they
are in textbooks (Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, chapter 7): none of the product's.

Both joints are driven along sums of sines by loops that nobody has told of; encoders count, torques have noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from hilbench.results.recording import Recording

Array = NDArray[np.float64]

_GRAVITY_M_S2 = 9.81
_PERIOD_S, _SECONDS = 2e-3, 12.0
_COUNT_RAD = 2.0 * np.pi / 16384.0
#: Stiffness and damping of the loops, N·m/rad and N·m·s/rad.
_STIFF, _DAMPED = np.array([60.0, 15.0]), np.array([6.0, 1.0])
#: Amplitude (rad), frequency (Hz) and phase of the sines of each joint.
_SINES = (
    ((0.5, 0.35, 0.0), (0.35, 0.8, 1.0), (0.12, 1.7, 2.0)),
    ((0.7, 0.45, 0.5), (0.5, 1.1, 2.5), (0.15, 2.1, 0.3)),
)


@dataclass(frozen=True)
class Arm:
    """Angle 1 from hanging down, angle 2 from link 1; the loops' torque is what the drives report."""

    masses_kg: tuple[float, float] = (0.6, 0.6)
    length_m: float = 0.25  #: of link 1
    centres_m: tuple[float, float] = (0.15, 0.2)
    inertias_kg_m2: tuple[float, float] = (0.01, 0.008)  #: about the centres; the rotors' as well
    coulomb_Nm: tuple[float, float] = (0.25, 0.15)
    noise_Nm: float = 5e-3
    zeros_rad: tuple[float, float] = (0.0, 0.0)  #: what the encoders say where the arm hangs straight
    seed: int = 1

    @property
    def gravity_Nm(self) -> tuple[float, float]:
        """Of link 1 with link 2 at its end, by angle 1; of link 2, by the sum of both angles."""
        (m1, m2), (r1, r2) = self.masses_kg, self.centres_m
        return (m1 * r1 + m2 * self.length_m) * _GRAVITY_M_S2, m2 * r2 * _GRAVITY_M_S2

    def rates(self, t_s: float, state: Array) -> Array:
        """Of the angles and their speeds."""
        (q1, q2), (v1, v2) = state[:2], state[2:]
        (m1, m2), (r1, r2), (i1, i2), l1 = self.masses_kg, self.centres_m, self.inertias_kg_m2, self.length_m
        h = m2 * l1 * r2
        m12 = m2 * r2**2 + h * np.cos(q2) + i2
        m11 = m1 * r1**2 + i1 + m2 * l1**2 + h * np.cos(q2) + m12
        matrix = np.array([[m11, m12], [m12, m2 * r2**2 + i2]])
        swung = h * np.sin(q2) * np.array([-(2.0 * v1 * v2 + v2**2), v1**2])
        g1, g2 = self.gravity_Nm
        weight = np.array([g1 * np.sin(q1) + g2 * np.sin(q1 + q2), g2 * np.sin(q1 + q2)])
        friction = np.array(self.coulomb_Nm) * np.tanh(np.array([v1, v2]) / 0.01)
        return np.concatenate([[v1, v2], np.linalg.solve(matrix, _driven(t_s, state) - swung - weight - friction)])

    def recording(self, joint: int, *, with_other: bool) -> Recording:
        """Of joint 1 or 2, as `x1_rad` and `tau1_Nm`; `x2_rad` is the other's angle."""
        t_s, angles, torques = _motion(replace(self, noise_Nm=0.0, zeros_rad=(0.0, 0.0), seed=0))
        rng = np.random.default_rng([self.seed, joint])
        counted = _COUNT_RAD * np.round((angles + np.array(self.zeros_rad)[:, None]) / _COUNT_RAD)
        torque = torques[joint - 1] + self.noise_Nm * rng.standard_normal(len(t_s))
        channels = {"t_s": t_s, "x1_rad": counted[joint - 1], "tau1_Nm": torque}
        return Recording(channels | ({"x2_rad": counted[2 - joint]} if with_other else {}))


@cache
def _motion(arm: Arm) -> tuple[Array, Array, Array]:
    """Times (n,), angles (2, n) and torques (2, n), whatever is measured of them."""
    t_s = np.arange(0.0, _SECONDS, _PERIOD_S)
    start = np.concatenate([_wanted(0.0)[0], _wanted(0.0)[1]])
    found = solve_ivp(arm.rates, (0.0, _SECONDS), start, "LSODA", t_s, rtol=1e-7, atol=1e-8)
    torques = np.array([_driven(t, q) for t, q in zip(t_s, found.y.T, strict=True)]).T
    return t_s, found.y[:2], torques


def _driven(t_s: float, state: Array) -> Array:
    angle, speed = _wanted(t_s)
    return np.asarray(_STIFF * (angle - state[:2]) + _DAMPED * (speed - state[2:]))


def _wanted(t_s: float) -> tuple[Array, Array]:
    """Angles and speeds of both joints."""
    angle = [sum(a * np.sin(2.0 * np.pi * f * t_s + p) for a, f, p in sines) for sines in _SINES]
    speed = [sum(2.0 * np.pi * f * a * np.cos(2.0 * np.pi * f * t_s + p) for a, f, p in sines) for sines in _SINES]
    return np.array(angle), np.array(speed)
