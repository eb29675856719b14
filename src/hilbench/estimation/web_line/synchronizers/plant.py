"""Plant parameters of the methods on the momentum balance, and estimates of their nuisance parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.estimation.web_line.config import AlsoEstimated
from hilbench.estimation.web_line.synchronizers.base import Estimate

#: Least noise of a torque.
TORQUE_FLOOR_NM = 1e-4
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
