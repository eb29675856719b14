"""What every synchronizer is given each cycle, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.balance import BalanceSample


@dataclass(slots=True)
class SyncSample:
    """What the twin knows at one SYNC; real and simulated values belong to the same instant."""

    cycle_s: float  #: time since the sample before
    torque_real_Nm: float  #: measured motor torque of axis 2
    torque_sim_Nm: float  #: the same quantity as the twin simulates it
    torque_sim_sensitivity_Nm_per_Pa: float  #: ∂τ2/∂E of the simulated motor torque at constant strain
    upstream_strain: float  #: of the web that enters the span, as the twin is told it
    balance: BalanceSample  #: of roller 2, from the measured motion


@dataclass(frozen=True, slots=True)
class Estimate:
    """An estimate of Young's modulus and how sure the method is of it."""

    youngs_modulus_Pa: float
    deviation_Pa: float  #: standard deviation; infinite where the method can't say
    nuisances: tuple[Nuisance, ...] = ()
    #: What is added to the strain of the web that enters a model that is left as it is otherwise; None: E is set in it.
    upstream_strain: float | None = None


class Synchronizer(Protocol):
    """Brings a model parameter to where simulation and measurement agree, one sample a cycle."""

    def update(self, sample: SyncSample) -> Estimate:
        """Take one sample in and return the estimate to simulate the next cycle with."""

    def rebase(self, change_Pa: float) -> None:
        """What is believed to be no tension is another force now: what was concluded of E moves by `change_Pa`."""

    def hold(self, duration_s: float) -> Estimate:
        """A cycle without a usable sample: the estimate stays, its deviation grows."""
