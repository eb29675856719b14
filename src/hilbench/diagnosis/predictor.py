"""What a diagnosis needs to know of a way to predict what a recording measured from a parameter vector."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.free_run import FreeRun
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.misfit import Condition
from hilbench.plant.web_line.imitation import Imitation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor

Array = NDArray[np.float64]

#: Share of a cycle by which a row of a bench's recording may be off the cycles.
_UNEVEN_CYCLES: Final = 1e-6
#: How far a row that is not as it was measured reaches through the filter of the motion, s.
_FILTERED_S: Final = 0.1


class Predictor(Protocol):
    """What a diagnosis needs to know of a way to predict."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the signals."""

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
        """Whether a right model leaves white noise and nothing else."""

    @property
    def tolerances(self) -> Array:
        """(signals,): what a signal may be off by beside its noise."""

    @property
    def imitation(self) -> Imitation | None:
        """How the web was imitated; None where a web was there."""

    def floor(self, signal: int) -> float:
        """Standard deviation of the noise of a signal, from the recording alone."""

    def conditions(self, parameters: Array) -> list[Condition]:
        """States that residuals may depend on, time first; (n,) each."""

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, signals, n)."""


def predictor_for(model: ModelParameters, data: Measured, imitation: Imitation | None = None) -> Predictor:
    """A free run where there are commands and control loops; else on the measured motion.

    Where the recording has a load motor the web was imitated: as `imitation` says, or as benches do it by default, by
    one load motor at the last roller. What happened in its cycles can't be told from rows between them.
    """
    if model.web is None:
        on_motion = OnMeasuredMotion(model, data)
        on_motion.rows &= data.usable(_FILTERED_S)[:: on_motion.every]
        return on_motion
    imitation = imitation or Imitation(data.period_s, (CoupledMotor(axis=model.axis_count),))
    cycles = data.period_s / imitation.cycle_s
    if not data.imitated or cycles < 0.5 or abs(cycles - round(cycles)) > _UNEVEN_CYCLES:
        return FreeRun(model, data)
    return FreeRun(model, data, imitation)
