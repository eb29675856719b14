"""Interface of synchronizers: sample, estimate, protocol."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.balance import BalanceSample


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


class Synchronizer(Protocol):
    """Estimator that moves a model parameter until simulation and measurement agree, one sample a cycle."""

    def update(self, sample: SyncSample) -> Estimate:
        """Update by one sample; returns the estimate for simulating the next cycle."""

    def rebase(self, change_Pa: float) -> None:
        """Shift E by `change_Pa` after a change of the force correction."""

    def hold(self, duration_s: float) -> Estimate:
        """Keep the estimate in a cycle without usable sample; its deviation grows."""
