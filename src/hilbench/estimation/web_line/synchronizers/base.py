"""Base of synchronizers: what they are of, sample, estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.assumptions import SEPARABLE
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.balance import BalanceSample, MeasuredBalance
from hilbench.estimation.web_line.config import AlsoEstimated, InputConfig, OnBalance


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


@dataclass(slots=True)
class SyncSample:
    """Sample at one SYNC; real and simulated values belong to the same instant."""

    cycle_s: float  #: time since the sample before
    torque_real_Nm: float  #: measured motor torque of axis 2
    torque_sim_Nm: float  #: the same quantity as the twin simulates it
    torque_sim_sensitivity_Nm_per_Pa: float  #: ∂τ2/∂E of the simulated motor torque at constant strain
    upstream_strain: float  #: of the web that enters the span, as stated to the twin
    balance: BalanceSample  #: of roller 2, from the measured motion


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate of Young's modulus, with its standard deviation."""

    youngs_modulus_Pa: float
    deviation_Pa: float  #: standard deviation; infinite where the method has none
    nuisances: tuple[Nuisance, ...] = ()
    #: Correction of the upstream strain of a model that is otherwise unchanged; None: E is set in the model.
    upstream_strain: float | None = None


class Synchronizer:
    """Estimator that moves a model parameter until simulation and measurement agree, one sample a cycle."""

    def update(self, sample: SyncSample) -> Estimate:
        """Update by one sample; returns the estimate for simulating the next cycle."""
        raise NotImplementedError

    def rebase(self, change_Pa: float) -> None:
        """Shift E by `change_Pa` after a change of the force correction; here no past value becomes wrong."""

    def hold(self, duration_s: float) -> Estimate:
        """Keep the estimate in a cycle without usable sample; its deviation grows."""
        raise NotImplementedError


class HeldSynchronizer(Synchronizer):
    """Synchronizer whose last estimate is held, and its deviation grown, in cycles without usable sample."""

    def __init__(self, config: OnBalance | InputConfig, plant: Plant) -> None:
        self._plant, self._hold_pct_per_s = plant, config.hold_growth_pct_per_s
        self._reference_Pa = plant.youngs_modulus_Pa
        deviation_Pa = 0.01 * config.initial_deviation_pct * plant.youngs_modulus_Pa
        self._estimate = Estimate(plant.youngs_modulus_Pa, deviation_Pa)

    def hold(self, duration_s: float) -> Estimate:
        """Keep the estimate; its deviation grows as by a random walk of so much after 1 s."""
        estimate = self._estimate
        walk_Pa = 0.01 * self._hold_pct_per_s * estimate.youngs_modulus_Pa
        deviation_Pa = sqrt(estimate.deviation_Pa**2 + walk_Pa**2 * duration_s)
        self._estimate = replace(estimate, deviation_Pa=deviation_Pa)
        return self._estimate


def prior_deviations(also: AlsoEstimated) -> Array:
    """Prior standard deviations of the nuisances, in the order of the filter's state."""
    return np.array([value for _, value in also])


def estimate_of(also: AlsoEstimated, reference_Pa: float, values: Array, deviations: Array) -> Estimate:
    """Estimate from values and deviations (5,) of E over its reference, and of the nuisance parameters; those with a
    prior are stated."""
    rows = zip(also, values[1:].tolist(), deviations[1:].tolist(), strict=True)
    found = [
        Nuisance(name, value, deviation, deviation < SEPARABLE * prior)
        for (name, prior), value, deviation in rows
        if prior > 0.0
    ]
    return Estimate(values.item(0) * reference_Pa, deviations.item(0) * reference_Pa, tuple(found))
