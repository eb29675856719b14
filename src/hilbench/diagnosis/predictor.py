"""Interface of a prediction of a recording's measured signals from a parameter vector."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.residual_analysis import Condition
from hilbench.diagnosis.web_line.loop_check import Loop
from hilbench.machine_kinds import machine_part
from hilbench.plant.model_file import Machine

#: Basis of a free run.
RECORDED_COMMANDS: Final = "the recorded commands"
#: Share of a cycle by which a row of a bench's recording may be off the cycles.
_UNEVEN_CYCLES: Final = 1e-6


class Predictor(Protocol):
    """Prediction that a diagnosis can use."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""

    @property
    def measured(self) -> Array:
        """(signals, n)."""

    @property
    def rows(self) -> NDArray[np.bool_]:
        """(n,): those that count."""

    @property
    def every(self) -> int:
        """Rows of the recording per row of the prediction."""

    @property
    def exact(self) -> bool:
        """True if a right model leaves white noise and nothing else."""

    @property
    def tolerances(self) -> Array:
        """(signals,): possible error of each signal in addition to its noise."""

    @property
    def emulation(self) -> AnyEmulation | None:
        """Emulation of web or shaft by a load motor; None where they were real."""

    @property
    def narrower(self) -> Predictor | None:
        """Prediction in half the band of frequencies; None where all are compared."""

    def floor(self, signal: int) -> float:
        """Standard deviation of the noise of a signal, from the recording alone."""

    def conditions(self, parameters: Array) -> list[Condition]:
        """States that residuals may depend on, time first; (n,) each."""

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, signals, n)."""


@dataclass(frozen=True)
class Choice:
    """Chosen prediction, why it was chosen, and the drives' loops as the recording shows them."""

    predictor: Predictor
    basis: str  #: for a person
    loops: list[Loop] = field(default_factory=list)  #: of the axes on which they could be looked at
    simpler: Choice | None = None  #: to be believed instead where it leaves nothing unexplained


def choice(model: Machine, data: Measured, emulation: AnyEmulation | None = None) -> Choice:
    """A free run where the drives' loops are those of the model; else on measured motion, which needs none.

    A recording with neither both positions nor both torques is run freely, with the loops that it shows. Where it has
    a load motor the web was emulated: as `emulation` says, or as benches do it by default, by one load motor at the
    last roller. Events within its cycles can't be seen in rows between them.
    """
    found: Choice = machine_part(model.kind, "diagnosis").choice(model, data, emulation)
    return found


def torques_of(predictor: Predictor) -> list[int]:
    """Numbers of the signals that are torques."""
    return [k for k, name in enumerate(predictor.names) if name.startswith("tau")]


def deviations_of(predictor: Predictor, tolerated: float = 1.0) -> Array:
    """(signals,): what a right model is off by: noise, and the tolerances, or a share of them."""
    floors = np.array([predictor.floor(k) for k in range(len(predictor.names))])
    return np.asarray(np.hypot(floors, tolerated * predictor.tolerances))


def is_cycle(cycles: float) -> bool:
    """True if a row of a bench's recording is whole cycles after the one before."""
    return cycles > 0.5 and abs(cycles - round(cycles)) <= _UNEVEN_CYCLES
