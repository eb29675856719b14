"""Plant parameters of the methods on the momentum balance, and filter inputs from samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hilbench.compiled import REAL, VECTOR, compiled, entry_point
from hilbench.estimation import noise_level
from hilbench.estimation.bank import Array
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.estimation.web_line.config import AlsoEstimated, ChangepointConfig, EkfConfig
from hilbench.estimation.web_line.synchronizers import kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample

#: Encoder noise assumed until it is measured, and its least value, m at the web; the least of a torque.
_POSITION_NOISE_M = 2e-7
_POSITION_FLOOR_M = 2e-8
TORQUE_FLOOR_NM = 1e-4
#: Smoothing of the acceleration that the mass error is weighed by.
_ACCELERATION_S = 0.02
#: Share of the inertial force that counts as noise: while the roller shakes, torque, load and position are less
#: simultaneous.
_SHAKING = 0.1
#: Time over which tension changes count as noise if a nuisance parameter is separated from E by the tension, s;
#: smoothing of that change. Vibration of the roller shakes the strain as well, and has no information.
_QUICK_S, _QUICK_SMOOTHING_S = 0.15, 0.02
#: A nuisance counts as separable from E when the data have shrunk its prior deviation to this share.
SEPARABLE = 0.7


@dataclass(frozen=True, slots=True)
class Plant:
    """Model parameters of roller 2 and the web; E in Pa where the method starts."""

    youngs_modulus_Pa: float
    mass_kg: float
    force_per_torque_per_m: float
    section_m2: float
    span_length_m: float

    @classmethod
    def of(cls, balance: MeasuredBalance, youngs_modulus_Pa: float) -> Plant:
        """Plant of a balance, with E as assumed at the start."""
        return cls(
            youngs_modulus_Pa,
            balance.mass_kg,
            balance.force_per_torque_per_m,
            balance.section_m2,
            balance.span_length_m,
        )


class InputVectors(NamedTuple):
    """Vectors of `FilterInputs`, for compiled callers."""

    u: Array  #: inputs of `kalman.step`
    s: Array  #: sizes of the plant, and state kept from cycle to cycle
    torque: Array  #: state of the torque's `NoiseLevel`
    position: Array  #: the same of the position's


# Of InputVectors.s: whether there is a cycle before, its force and web; smoothed speed and tension; sizes.
(
    _HAS_BEFORE,
    _BEFORE_N,
    _BEFORE_PER_PA,
    _SMOOTHED_M_S,
    _SMOOTHED_WEB_N,
    _MODULUS_PA,
    _MASS_KG,
    _PER_TORQUE2,  # variance of the force per variance of the torque
    _PER_POSITION2,  # the same per variance of the position
    _SLOWLY,  # a nuisance parameter is separated from E by the tension
) = range(10)
_SIZE = 10


@compiled
def fill(
    inputs: InputVectors,
    cycle_s: float,
    torque_Nm: float,
    x2_m: float,
    force_N: float,
    web_per_Pa: float,
    velocity_m_s: float,
) -> bool:
    """Fill `u` by the balance of this cycle; False for the first of a row, which has no previous cycle."""
    u, s = inputs.u, inputs.s
    noise_level.take(inputs.torque, torque_Nm)
    noise_level.take(inputs.position, x2_m)
    has_before, before_N, before_per_Pa = s[_HAS_BEFORE], s[_BEFORE_N], s[_BEFORE_PER_PA]
    s[_HAS_BEFORE] = 1.0
    s[_BEFORE_N] = force_N
    s[_BEFORE_PER_PA] = web_per_Pa
    if has_before == 0.0:
        s[_SMOOTHED_M_S] = velocity_m_s
        s[_SMOOTHED_WEB_N] = web_per_Pa * s[_MODULUS_PA]
        u[kalman.ACCELERATION_M_S2] = 0.0
        return False
    slope = (velocity_m_s - s[_SMOOTHED_M_S]) / (_ACCELERATION_S + cycle_s)
    s[_SMOOTHED_M_S] += slope * cycle_s
    u[kalman.ACCELERATION_M_S2] = slope
    position_variance = noise_level.variance(inputs.position)
    u[kalman.DURATION_S] = cycle_s
    u[kalman.FORCE_N] = 0.5 * (force_N + before_N)
    u[kalman.WEB_N] = 0.5 * (web_per_Pa + before_per_Pa) * s[_MODULUS_PA]
    u[kalman.SPEED_M_S] = velocity_m_s
    # The strain is a difference of two positions, so their noise is noise of the tension.
    u[kalman.FORCE_VARIANCE] = (
        s[_PER_TORQUE2] * noise_level.variance(inputs.torque)
        + s[_PER_POSITION2] * position_variance
        + (_SHAKING * s[_MASS_KG] * slope) ** 2
    )
    if s[_SLOWLY] != 0.0:
        web_N_per_s = (u[kalman.WEB_N] - s[_SMOOTHED_WEB_N]) / (_QUICK_SMOOTHING_S + cycle_s)
        s[_SMOOTHED_WEB_N] += web_N_per_s * cycle_s
        u[kalman.FORCE_VARIANCE] += (_QUICK_S * web_N_per_s) ** 2
    u[kalman.POSITION_M] = x2_m
    u[kalman.POSITION_VARIANCE] = position_variance
    return True


Fill = Callable[[Array, Array, Array, Array, float, float, float, float, float, float], bool]


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, REAL, REAL, REAL, REAL, REAL, REAL)
def _fill(
    u: Array,
    s: Array,
    torque: Array,
    position: Array,
    cycle_s: float,
    torque_Nm: float,
    x2_m: float,
    force_N: float,
    web_per_Pa: float,
    velocity_m_s: float,
) -> bool:
    inputs = InputVectors(u, s, torque, position)
    return fill(inputs, cycle_s, torque_Nm, x2_m, force_N, web_per_Pa, velocity_m_s)


class FilterInputs:
    """Inputs of `kalman.step` from samples: means over the cycle, and their noise."""

    def __init__(self, plant: Plant, config: EkfConfig | ChangepointConfig) -> None:
        self.u = np.zeros(kalman.INPUTS)
        self.priors = prior_deviations(config.also)
        self.u[kalman.PRIORS :] = self.priors
        self.u[kalman.MASS_KG] = plant.mass_kg
        self.u[kalman.FORCE_PER_TORQUE] = plant.force_per_torque_per_m
        stiffness_per_m = plant.youngs_modulus_Pa * plant.section_m2 / plant.span_length_m
        self._s = np.zeros(_SIZE)
        self._s[_MODULUS_PA], self._s[_MASS_KG] = plant.youngs_modulus_Pa, plant.mass_kg
        self._s[_PER_TORQUE2], self._s[_PER_POSITION2] = plant.force_per_torque_per_m**2, 2.0 * stiffness_per_m**2
        self._s[_SLOWLY] = float(self.priors[:-1].any())
        self._torque = NoiseLevel(config.torque_noise_Nm, TORQUE_FLOOR_NM)
        self._position = NoiseLevel(_POSITION_NOISE_M, _POSITION_FLOOR_M)

    @property
    def vectors(self) -> InputVectors:
        """Vectors of the inputs, for compiled callers."""
        return InputVectors(self.u, self._s, self._torque.state, self._position.state)

    def interrupt(self) -> None:
        """Form no mean across a missing cycle."""
        self._s[_HAS_BEFORE] = 0.0

    def update(self, sample: SyncSample) -> bool:
        """Fill `u`; False for the first sample of a row, which has no previous cycle."""
        balance = sample.balance
        return _fill(
            *self.vectors,
            sample.cycle_s,
            sample.torque_real_Nm,
            balance.x2_m,
            balance.force_N,
            balance.web_per_Pa,
            balance.velocity_m_s,
        )


def prior_deviations(also: AlsoEstimated) -> np.ndarray:
    """Prior standard deviations of the nuisances, in the order of the filter's state."""
    return np.array([value for _, value in also])


def nuisances(
    also: Sequence[tuple[str, float]], values: Sequence[float], deviations: Sequence[float]
) -> tuple[Nuisance, ...]:
    """Estimates of the nuisance parameters. `also`: names and priors of `AlsoEstimated`; values and deviations (4,) in
    the order of the filter's state."""
    rows = zip(also, values, deviations, strict=True)
    return tuple(
        [
            Nuisance(name, value, deviation, deviation < SEPARABLE * prior)
            for (name, prior), value, deviation in rows
            if prior > 0.0
        ]
    )


def held(estimate: Estimate, growth_pct_per_s: float, duration_s: float) -> Estimate:
    """Copy of the estimate, its deviation grown as by a random walk of that size after 1 s."""
    walk_Pa = 0.01 * growth_pct_per_s * estimate.youngs_modulus_Pa
    deviation_Pa = float(np.sqrt(estimate.deviation_Pa**2 + walk_Pa**2 * duration_s))
    return replace(estimate, deviation_Pa=deviation_Pa)
