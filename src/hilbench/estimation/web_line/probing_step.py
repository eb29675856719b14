"""E from a probing step of strain: terms that do not change with it cancel.

Constant speed, force and strain of many short blocks (`_BLOCK_S`), of the momentum balance of the roller after the
span:

    force - m·v2' = E·h + b + c·t

with h = F/E by the encoders. Dry friction (while the direction of motion stays), a torque offset and other constants
are b, their slow change is c·t; E is the slope against h alone. Its deviation is that of least squares with the blocks'
scatter; without a change of strain it is wide.

A tension change of 2 % shows in a torque whose noise is as large. With a known velocity loop its changes follow from
the encoder without that noise: kp·e + ki·∫e dt of the speed error e. They are used as long as they agree with the
measured ones, and their E is no more certain than the loop's gains.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import hypot, isfinite, sqrt

import numpy as np

from hilbench.estimation.web_line.balance import BalanceSample
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters

#: The encoder's noise must be small in the mean of a block; a probe has many of them.
_BLOCK_S = 0.05
#: Time over which the speed at the edge of a block is taken.
_EDGE_S = 0.02
#: Settling time after a ramp.
_SETTLED_S = 0.5
#: Change of the roller's speed set-point, as a share of it, from which on it is another motion.
_STEADY = 1e-4
#: Least blocks, and longest time, s, over which one slope is fitted.
_LEAST_BLOCKS, _LONGEST_S = 20, 60.0
#: Change of the estimate of E over the blocks from which on E itself must have changed.
_CHANGED = 0.03
#: Deviations by which two slopes of the same changes may differ.
_AGREE = 3.0
#: Largest deviation of E, in %, by a probing step, and its largest share of that stated before.
_KNOWN_PCT, _BETTER_BY = 0.3, 0.9


@dataclass(frozen=True, slots=True)
class DriveLoop:
    """Velocity loop of the roller's drive, at the web, and the relative deviation of its gains."""

    kp_N_s_per_m: float
    ki_N_per_m: float
    current_loop_s: float  #: lag of the torque behind what the loop asks for
    sample_s: float
    deviation: float


@dataclass(frozen=True, slots=True)
class KnownTension:
    """Result of a probing step: E in Pa with its deviation, and the constant force (N) that is no tension."""

    youngs_modulus_Pa: float
    deviation_Pa: float
    force_N: float

    def is_more_certain_than(self, youngs_modulus_Pa: float, deviation_Pa: float) -> bool:
        """True if E is found, and more certain than the known one with this deviation."""
        limit_Pa = min(0.01 * _KNOWN_PCT * youngs_modulus_Pa, _BETTER_BY * deviation_Pa)
        return 0.0 < self.deviation_Pa <= limit_Pa and self.youngs_modulus_Pa > 0.0


#: Of a cycle or a block: h in N/Pa, the force, and the loop's force in addition, N.
_Values = tuple[float, float, float]


class ProbingStep:
    """Estimator of E on blocks of one steady motion. `loop`: None if only the measured torque is usable."""

    def __init__(self, mass_kg: float, loop: DriveLoop | None, cycle_s: float) -> None:
        self._mass_kg = mass_kg
        self._loop = loop
        self._cycle_s = cycle_s
        self._cycles = max(round(_BLOCK_S / cycle_s), 2)
        self.reset()

    def reset(self) -> None:
        """Forget all blocks: another motion, or another E."""
        self._blocks: list[_Values] = []
        self._modulus_Pa: float | None = None
        self._speed_m_s: float | None = None
        self._steady_s = self._lag_m = 0.0
        reach = max(round(0.5 * _EDGE_S / self._cycle_s), 1)
        self._positions_m: deque[float] = deque(maxlen=2 * reach + 1)
        self._values: deque[_Values] = deque(maxlen=reach + 2)  # down to one before the middle of the positions
        self._begin(None)

    def believe(self, youngs_modulus_Pa: float) -> None:
        """Take the result as the estimate from here on; the blocks are kept."""
        self._modulus_Pa = youngs_modulus_Pa

    def _begin(self, velocity_m_s: float | None) -> None:
        self._first_m_s = velocity_m_s
        self._sums: _Values = (0.0, 0.0, 0.0)
        self._count = 0

    def update(
        self, now: BalanceSample, set_point_m_s: float, torque_N: float, modulus_Pa: float
    ) -> KnownTension | None:
        """Take a cycle: the balance, the roller's speed set-point, the part of the balance's force from the measured
        torque, and the estimated E. Returns a result when a block is complete, else None."""
        if not self._is_same(now, set_point_m_s, modulus_Pa):
            self.reset()
            self._speed_m_s, self._modulus_Pa = set_point_m_s, modulus_Pa
            return None
        self._steady_s += self._cycle_s
        if self._steady_s < _SETTLED_S:
            return None
        self._lag_m += (set_point_m_s - now.velocity_m_s) * self._cycle_s
        held_N = self._loop.ki_N_per_m * self._lag_m - torque_N if self._loop is not None else 0.0
        self._positions_m.append(now.x2_m)
        self._values.append((now.web_per_Pa, now.force_N, held_N))
        positions_m = self._positions_m
        if len(positions_m) < (positions_m.maxlen or 0):
            return None
        # Speed, and so momentum, at the middle of the kept positions; forces from one such instant to the next.
        speed_m_s = (positions_m[-1] - positions_m[0]) / ((len(positions_m) - 1) * self._cycle_s)
        return self._take(speed_m_s)

    def _is_same(self, now: BalanceSample, set_point_m_s: float, modulus_Pa: float) -> bool:
        """True if this cycle continues the steady motion with the same E."""
        if self._speed_m_s is None or self._modulus_Pa is None or not set_point_m_s:
            return False
        steady = abs(set_point_m_s - self._speed_m_s) <= _STEADY * abs(set_point_m_s)
        unchanged = abs(modulus_Pa / self._modulus_Pa - 1.0) <= _CHANGED
        usable = isfinite(now.force_N) and isfinite(now.web_per_Pa) and now.web_per_Pa > 0.0
        return steady and unchanged and usable and len(self._blocks) * _BLOCK_S <= _LONGEST_S

    def _take(self, speed_m_s: float) -> KnownTension | None:
        if self._first_m_s is None:
            self._begin(speed_m_s)
            return None
        before, at = self._values[0], self._values[1]
        web, force_N, held_N = (0.5 * (one + other) for one, other in zip(before, at, strict=True))
        if self._loop is not None:  # the set-point is constant: its part is, too
            # A lagging integral lacks a part proportional to the speed error. The hold of half a sample is compensated
            # by the last error, which a sampled integral already contains.
            kp_N_s_per_m = self._loop.kp_N_s_per_m - self._loop.ki_N_per_m * self._loop.current_loop_s
            held_N -= kp_N_s_per_m * speed_m_s
        self._sums = (self._sums[0] + web, self._sums[1] + force_N, self._sums[2] + held_N)
        self._count += 1
        if self._count < self._cycles:
            return None
        taken_N = self._mass_kg * (speed_m_s - self._first_m_s) / (self._count * self._cycle_s)
        web, force_N, held_N = (total / self._count for total in self._sums)
        if self._loop is not None:
            lag_kg = self._loop.kp_N_s_per_m * (self._loop.current_loop_s + 0.5 * self._loop.sample_s)
            held_N += lag_kg / self._mass_kg * taken_N
        self._blocks.append((web, force_N - taken_N, held_N))
        self._begin(speed_m_s)
        return self._known() if len(self._blocks) >= _LEAST_BLOCKS else None

    def _known(self) -> KnownTension:
        blocks = np.array(self._blocks)
        slope_Pa, deviation_Pa = _slope(blocks[:, 0], blocks[:, 1])
        if self._loop is not None:
            by_loop_Pa, of_loop_Pa = _slope(blocks[:, 0], blocks[:, 1] + blocks[:, 2])
            of_loop_Pa = hypot(of_loop_Pa, self._loop.deviation * by_loop_Pa)
            if abs(by_loop_Pa - slope_Pa) <= _AGREE * hypot(of_loop_Pa, deviation_Pa) and of_loop_Pa < deviation_Pa:
                slope_Pa, deviation_Pa = by_loop_Pa, of_loop_Pa
        # The constant is that of the measured torque: the loop has only the changes.
        constant_N = float(np.mean(blocks[:, 1] - slope_Pa * blocks[:, 0]))
        return KnownTension(slope_Pa, deviation_Pa, constant_N)


def _slope(web_per_Pa: np.ndarray, force_N: np.ndarray) -> tuple[float, float]:
    """Slope of the force (n,) against h (n,), after a constant and a trend, and its deviation."""
    count = len(force_N)
    trend = np.column_stack([np.ones(count), np.linspace(-1.0, 1.0, count)])
    # Constant and trend are projected out of both; the rest is a line through the origin.
    both = np.column_stack([web_per_Pa, force_N])
    both = both - trend @ np.linalg.lstsq(trend, both, rcond=None)[0]
    size = float(both[:, 0] @ both[:, 0])
    if size == 0.0:
        return 0.0, np.inf
    slope = float(both[:, 0] @ both[:, 1]) / size
    left = both[:, 1] - slope * both[:, 0]
    return slope, sqrt(float(left @ left) / (count - 3) / size)


def new_probing_step(
    model: ModelParameters, config: EstimationConfig, mass_kg: float, cycle_s: float
) -> ProbingStep | None:
    """Probing-step estimator, or None if it is not configured."""
    wanted = config.known_change
    if wanted is None:
        return None
    loop = None
    if wanted.loop_gain_deviation_pct is not None and model.drives is not None:
        squared = model.motor_rad_per_m(2) ** 2
        loop = DriveLoop(
            per_item(model.drives.velocity_kp_Nm_s_per_rad, 2) * squared,
            per_item(model.drives.velocity_ki_Nm_per_rad, 2) * squared,
            per_item(model.drives.current_loop_time_constant_s, 2),
            model.drives.sample_time_s,
            0.01 * wanted.loop_gain_deviation_pct,
        )
    return ProbingStep(mass_kg, loop, cycle_s)
