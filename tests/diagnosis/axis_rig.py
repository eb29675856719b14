"""A servo axis on a stand, simulated with other equations than the product's: LuGre friction, loops that nobody has
told of, an encoder's counts, torque with noise, a friction that wanders, and a shaft that twists. All repeats at
once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

Array = NDArray[np.float64]

_STEP_S, _EVERY = 2e-4, 5
_TURN = 2.0 * np.pi
#: Presliding stiffness, N·m/rad: Coulomb friction is built up over some 1e-3 rad.
_BRISTLE = 40.0


@dataclass(frozen=True)
class Rig:
    """A rotary axis; radius 1 m and gear 1 in its model make N be N·m."""

    inertia_kg_m2: float = 2e-4
    viscous_Nm_s: float = 3e-4
    coulomb_Nm: float = 0.03
    offset_Nm: float = -4e-3
    ripple_Nm: float = 1.2e-3  #: 5 per turn
    spring_Nm: float = 0.0  #: a torque that goes with the fourth power of the angle, at 60 rad
    counts_per_turn: int = 10_000
    wander_Nm: float = 2e-4  #: of the friction
    noise_Nm: float = 1e-3
    seconds: float = 10.0
    behind_kg_m2: float = 0.0  #: of the inertia, behind a torsional shaft
    shaft_Nm_per_rad: float = 0.0  #: its stiffness
    shaft_Nm_s_per_rad: float = 0.0  #: its damping
    stepped: bool = False  #: steps of the speed both ways in place of triangles
    swing: tuple[float, float] | None = None  #: Hz and rad/s of one steady sine in their place
    about_rad_s: float = 0.0  #: the mean speed of that sine

    def _speed(self, t_s: float) -> float:
        if self.swing is not None:
            return self.about_rad_s + self.swing[1] * math.sin(_TURN * self.swing[0] * t_s)
        return _stepped(t_s) if self.stepped else _triangle(t_s)

    def recordings(self, repeats: int, seed: int = 0) -> list[Recording]:
        """Triangles of speed in both directions at 1 kHz, or steps of it, as often."""
        steps = round(self.seconds / _STEP_S)
        drawn = np.random.default_rng(seed).standard_normal((steps - steps // -_EVERY, repeats))
        return [self._recording(steps, drawn[:, k].tolist()) for k in range(repeats)]

    def _recording(self, steps: int, drawn: list[float]) -> Recording:
        noise = iter(drawn)
        x = v = z = integral = wander = twist = speed_behind = 0.0
        forget, most = _STEP_S / 0.5, self.coulomb_Nm / _BRISTLE
        wanders_Nm = self.wander_Nm * math.sqrt(2.0 * forget)
        angles, torques = [], []
        for k in range(steps):
            error = self._speed(k * _STEP_S) - v
            integral += 0.4 * error * _STEP_S
            torque = min(max(0.02 * error + integral, -0.3), 0.3)
            z = min(max(z + v * _STEP_S, -most), most)
            wander += -forget * wander + wanders_Nm * next(noise)
            friction = _BRISTLE * z + self.viscous_Nm_s * v + wander + self.spring_Nm * (x / 60.0) ** 4
            shaft = 0.0
            if self.behind_kg_m2:
                shaft = self.shaft_Nm_per_rad * twist + self.shaft_Nm_s_per_rad * (v - speed_behind)
                speed_behind += _STEP_S * shaft / self.behind_kg_m2
            turning = torque + self.ripple_Nm * math.sin(5.0 * x + 0.7) - friction - shaft
            v += _STEP_S * turning / (self.inertia_kg_m2 - self.behind_kg_m2)
            x += _STEP_S * v
            twist += _STEP_S * (v - speed_behind)
            if k % _EVERY == 0:
                angles.append(x)
                torques.append(torque + self.offset_Nm + self.noise_Nm * next(noise))
        count = _TURN / self.counts_per_turn
        counted = count * np.round(np.array(angles) / count)
        t_s = np.arange(len(angles)) * _STEP_S * _EVERY
        return Recording({"t_s": t_s, "x1_m": counted, "tau1_Nm": np.array(torques)})


def _triangle(t_s: float) -> float:
    """Up to 60 rad/s and back in 4 s, then the other way, then standstill."""
    return 30.0 * (2.0 - abs(t_s % 4.0 - 2.0)) * (1.0 if t_s < 4.0 else -1.0) if t_s < 8.0 else 0.0


def _stepped(t_s: float) -> float:
    """A speed for 0.4 s, then another, in both directions, none of them for long."""
    return 50.0 * math.sin(1.0 + 2.4 * (t_s // 0.4) ** 1.5)


def axis_model(inertia_kg_m2: float) -> ModelParameters:
    """What is known of the rig: an inertia, and no friction."""
    return ModelParameters.model_validate(
        {
            "rollers": {"radius_m": 1.0, "inertia_kg_m2": inertia_kg_m2, "gear_ratio": 1.0},
            "motors": {"inertia_kg_m2": 0.0},
            "effects": [],
        }
    )
