"""What the methods on the momentum balance know of the plant, and what they make of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.estimation.web_line.config import AlsoEstimated, ChangepointConfig, EkfConfig
from hilbench.estimation.web_line.synchronizers import kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample

#: Encoder noise believed before it is measured, and the least that is believed, m at the web.
_POSITION_NOISE_M = 2e-7
_POSITION_FLOOR_M = 2e-8
_TORQUE_FLOOR_NM = 1e-4
#: Smoothing of the acceleration by which the error of the mass is weighed.
_ACCELERATION_S = 0.02
#: Share of the inertial force that counts as noise: while the roller shakes, torque, load and position are less of one
#: instant than else.
_SHAKING = 0.1
#: Time over which the tension changes that counts as noise where something is looked for that the tension tells from E,
#: s; smoothing of that change. What shakes the roller shakes the strain as well, and tells nothing.
_QUICK_S, _QUICK_SMOOTHING_S = 0.15, 0.02
#: A nuisance counts as told apart from E when the data have shrunk its prior deviation to this share.
SEPARABLE = 0.7


@dataclass(frozen=True, slots=True)
class Plant:
    """Roller 2 and the web as the twin's model has them; E in Pa where the method starts."""

    youngs_modulus_Pa: float
    mass_kg: float
    force_per_torque_per_m: float
    section_m2: float
    span_length_m: float

    @classmethod
    def of(cls, balance: MeasuredBalance, youngs_modulus_Pa: float) -> Plant:
        """The plant of a balance, with E as assumed at the start."""
        return cls(
            youngs_modulus_Pa,
            balance.mass_kg,
            balance.force_per_torque_per_m,
            balance.section_m2,
            balance.span_length_m,
        )


class FilterInputs:
    """Turns samples into the inputs of `kalman.step`: means over the cycle, and how noisy they are."""

    def __init__(self, plant: Plant, config: EkfConfig | ChangepointConfig) -> None:
        self.u = np.zeros(kalman.INPUTS)
        self.priors = prior_deviations(config.also)
        self.u[kalman.PRIORS :] = self.priors
        self.u[kalman.MASS_KG] = plant.mass_kg
        self.u[kalman.FORCE_PER_TORQUE] = plant.force_per_torque_per_m
        self._plant = plant
        self._stiffness_per_m = plant.youngs_modulus_Pa * plant.section_m2 / plant.span_length_m
        self._torque = NoiseLevel(config.torque_noise_Nm, _TORQUE_FLOOR_NM)
        self._position = NoiseLevel(_POSITION_NOISE_M, _POSITION_FLOOR_M)
        self._before: tuple[float, float] | None = None
        self._speed_m_s = 0.0
        self._slowly = bool(self.priors[:-1].any())
        self._web_N = self._web_N_per_s = 0.0

    def interrupt(self) -> None:
        """A cycle is missing: no mean is formed across it."""
        self._before = None

    def update(self, sample: SyncSample) -> bool:
        """Fill `u`; False for the first sample of a row, which has no cycle before it."""
        balance, u = sample.balance, self.u
        self._torque.update(sample.torque_real_Nm)
        self._position.update(balance.x2_m)
        now = (balance.force_N, balance.web_per_Pa)
        before, self._before = self._before, now
        if before is None:
            self._speed_m_s = balance.velocity_m_s
            self._web_N = balance.web_per_Pa * self._plant.youngs_modulus_Pa
            u[kalman.ACCELERATION_M_S2] = 0.0
            return False
        slope = (balance.velocity_m_s - self._speed_m_s) / (_ACCELERATION_S + sample.cycle_s)
        self._speed_m_s += slope * sample.cycle_s
        u[kalman.ACCELERATION_M_S2] = slope
        position_variance = self._position.variance
        u[kalman.DURATION_S] = sample.cycle_s
        u[kalman.FORCE_N] = 0.5 * (now[0] + before[0])
        u[kalman.WEB_N] = 0.5 * (now[1] + before[1]) * self._plant.youngs_modulus_Pa
        u[kalman.SPEED_M_S] = balance.velocity_m_s
        # The strain is a difference of two positions, so their noise is noise of the tension.
        u[kalman.FORCE_VARIANCE] = (
            self._plant.force_per_torque_per_m**2 * self._torque.variance
            + 2.0 * self._stiffness_per_m**2 * position_variance
            + (_SHAKING * self._plant.mass_kg * slope) ** 2
        )
        if self._slowly:
            self._web_N_per_s = (u[kalman.WEB_N] - self._web_N) / (_QUICK_SMOOTHING_S + sample.cycle_s)
            self._web_N += self._web_N_per_s * sample.cycle_s
            u[kalman.FORCE_VARIANCE] += (_QUICK_S * self._web_N_per_s) ** 2
        u[kalman.POSITION_M] = balance.x2_m
        u[kalman.POSITION_VARIANCE] = position_variance
        return True


def prior_deviations(also: AlsoEstimated) -> np.ndarray:
    """Prior standard deviations of the nuisances, in the order of the filter's state."""
    return np.array([value for _, value in also])


def nuisances(
    also: Sequence[tuple[str, float]], values: Sequence[float], deviations: Sequence[float]
) -> tuple[Nuisance, ...]:
    """The estimates of what is estimated beside E. `also`: names and priors of `AlsoEstimated`; values and deviations
    (4,) in the order of the filter's state."""
    rows = zip(also, values, deviations, strict=True)
    return tuple(
        [
            Nuisance(name, value, deviation, deviation < SEPARABLE * prior)
            for (name, prior), value, deviation in rows
            if prior > 0.0
        ]
    )


def held(estimate: Estimate, growth_pct_per_s: float, duration_s: float) -> Estimate:
    """The same estimate, its deviation grown as by a random walk of that size after 1 s."""
    walk_Pa = 0.01 * growth_pct_per_s * estimate.youngs_modulus_Pa
    deviation_Pa = float(np.sqrt(estimate.deviation_Pa**2 + walk_Pa**2 * duration_s))
    return replace(estimate, deviation_Pa=deviation_Pa)
