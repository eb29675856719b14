"""A line of two driven rollers, as it is diagnosed while it runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.measured import Measured
from hilbench.live.web_line import models, stretch
from hilbench.live.web_line.gap import ModelGap
from hilbench.live.window import Window
from hilbench.plant.effect import MachineKind
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line.imitation import Imitation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes

Array = NDArray[np.float64]


class LiveLine:
    """A `LiveMachine` whose twin estimates E. `imitation`: how the web is imitated, None where it is there."""

    kind = MachineKind.WEB_LINE
    speeds = ("v1_m_s", "v2_m_s")
    needed = ("x1_m", "x2_m", *speeds, "tau1_Nm", "tau2_Nm", "strain_prev", "F_next_N")
    moves = 0.05  #: m/s
    shown_axis = 2  #: it carries the web
    estimated = "E_sim_Pa"

    def __init__(self, model: ModelParameters, imitation: Imitation | None, cycle_s: float) -> None:
        self.configured, self.imitation = model, imitation
        self.usual_Nm = np.array(
            [machine_sizes(model, k).force_N / model.motor_rad_per_m(k) for k in range(1, model.axis_count + 1)]
        )
        self._cycle_s = cycle_s

    def gap(self, model: Machine) -> ModelGap:
        """Of one model."""
        return ModelGap(models.line(model), self._cycle_s)

    def estimate_of(self, model: Machine) -> float:
        """E as the model has it, Pa."""
        return models.line(model).youngs_modulus_Pa(1)

    def with_estimate(self, model: Machine, estimate: float) -> ModelParameters:
        """The model with another E."""
        return models.with_modulus(models.line(model), estimate)

    def estimate_at(self, model: Machine, time_s: float) -> float:
        """E as the model's effects make it at a time of theirs."""
        return models.modulus_at(model, time_s)

    def is_of_estimate(self, effect_id: str) -> bool:
        """Whether an effect is a change of E."""
        return models.is_of_estimate(effect_id)

    def without_estimate(self, model: Machine) -> ModelParameters:
        """The model without changes of E but for those that it was configured with."""
        return models.without_estimate(model, self.configured)

    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first cycle before which, for a while, neither speeds nor tension change; None where there is none."""
        return stretch.quiet_cycle(window, first, end, self._cycle_s)

    def estimate_in(self, window: Window, model: Machine, known: float, first: int, end: int) -> float:
        """As it is known: what a line lacks looks like another E too often."""
        return known

    def data_of(self, window: Window, model: Machine, first: int, end: int) -> Measured:
        """What a diagnosis takes from these cycles. Raises UnusableInputError for what can't be diagnosed."""
        return stretch.data_of(window, models.line(model), self.imitation, first, end, self._cycle_s)

    def packed(self, model: Machine) -> Array:
        """(P,): as a predictor takes it."""
        return stretch.packed(models.line(model))
