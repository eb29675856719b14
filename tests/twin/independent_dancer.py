"""Three driven rollers, a dancer and a guide roller, written apart from the product: for its twin to follow.

Unstretched length in a span: its rate is u1/(1 + e1) - u2/(1 + e2), u the speeds of the surfaces of the rollers at its
ends and e1 the strain of the web that comes; the dancer's carriage lengthens the spans beside it by its way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from tests.twin.speed_driven import SpeedDriven

from hilbench.plant.motor_port import MotorPort

Array = np.ndarray
_DRIVEN, _FREE = slice(0, 5, 2), slice(1, 5, 2)
_ROLLERS, _SPANS = 5, 4
_BESIDE_THE_DANCER = np.array([1.0, 1.0, 0.0, 0.0])


@dataclass
class IndependentDancer(SpeedDriven):
    """Rollers in the direction of the web: driven, dancer's, driven, guide, driven. `slip` (5,): share by which the web
    is slower than each; `modulus_Pa` (4,): of the spans."""

    modulus_Pa: Array = field(default_factory=lambda: np.full(_SPANS, 8.7e9))
    lengths_m: tuple[float, ...] = (1.5, 2.5, 2.0, 3.0)
    section_m2: float = 0.5 * 65e-6
    entering: float = 2.829e-4
    next_N: float = 70.0
    carriage_kg: float = 10.0
    friction_N_s_per_m: float = 400.0
    force_N: float = 160.0
    radius_m: float = 0.2
    driven_kg_m2: float = 1.167 + 25.0 * 0.001
    free_kg: tuple[float, float] = (0.0025 / 0.05**2, 0.004 / 0.06**2)
    gear: float = 5.0
    kp: float = 1.5
    ki: float = 30.0
    slip: Array = field(default_factory=lambda: np.zeros(_ROLLERS))
    strains: Array | None = None  #: of the spans at the start (4,); as of the web that enters where it is None
    ports: list[MotorPort] = field(default_factory=lambda: [MotorPort() for _ in range(3)])
    STEPS = 4

    def __post_init__(self) -> None:
        strains = np.full(_SPANS, self.entering) if self.strains is None else self.strains
        self._lengths_m = np.array(self.lengths_m)
        self._around, self._before = np.zeros(_ROLLERS + 1), np.zeros(_ROLLERS)
        unstretched = self._lengths_m / (1.0 + strains)
        # Ways and speeds of the rollers' surfaces, the carriage's place and speed, unstretched lengths.
        self._begin(np.concatenate([np.zeros(2 * _ROLLERS + 2), unstretched]))
        self._per_m = self.gear / self.radius_m
        self._masses = np.empty(_ROLLERS)
        self._masses[_DRIVEN], self._masses[_FREE] = self.driven_kg_m2 / self.radius_m**2, self.free_kg
        self._show()

    def _strains(self, y: Array) -> Array:
        lengths = self._lengths_m + _BESIDE_THE_DANCER * y[2 * _ROLLERS]
        strains: Array = lengths / y[2 * _ROLLERS + 2 :] - 1.0
        return strains

    def _rates(self, y: Array) -> Array:
        speeds, moves = y[_ROLLERS : 2 * _ROLLERS], y[2 * _ROLLERS + 1]
        strains = self._strains(y)
        pulls = self.modulus_Pa * self.section_m2 * strains
        around, before = self._around, self._before
        around[0], around[1:-1], around[-1] = pulls[0], pulls, self.next_N  # nobody pulls at the first roller
        pushes = around[1:] - around[:-1]
        pushes[_DRIVEN] += self._torque * self._per_m
        lifts = (self.force_N - self.friction_N_s_per_m * moves - pulls[0] - pulls[1]) / self.carriage_kg
        before[0], before[1:] = self.entering, strains
        carried = speeds * (1.0 - self.slip) / (1.0 + before)
        rates = np.empty_like(y)
        rates[:_ROLLERS], rates[_ROLLERS : 2 * _ROLLERS] = speeds, pushes / self._masses
        rates[2 * _ROLLERS], rates[2 * _ROLLERS + 1] = moves, lifts
        rates[2 * _ROLLERS + 2 :] = carried[:-1] - carried[1:]
        return rates

    def _motors(self) -> tuple[Array, Array]:
        travels, speeds = self._y[:_ROLLERS], self._y[_ROLLERS : 2 * _ROLLERS]
        return self._per_m * travels[_DRIVEN], self._per_m * speeds[_DRIVEN]

    def outputs(self) -> dict[str, float]:
        """Tensions, and where the dancer stands."""
        tensions = self.modulus_Pa * self.section_m2 * self._strains(self._y)
        of_spans = {f"F{k}_N": float(value) for k, value in enumerate(tensions, 1)}
        return of_spans | {"x_dancer_m": float(self._y[2 * _ROLLERS])}
