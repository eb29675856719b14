"""A line of driven rollers, as it is diagnosed while it runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.measured import Measured
from hilbench.live.machine import SHORT
from hilbench.live.models import why_not_carried
from hilbench.live.web_line import models, segment
from hilbench.live.web_line.gap import ModelGap, exchanged_m
from hilbench.live.window import Window
from hilbench.plant.effect import MachineKind
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes

Array = NDArray[np.float64]


class LiveLine:
    """A `LiveMachine` whose twin estimates E. `emulation`: how the web is emulated, None where it is there;
    `spans`: in which E is estimated, None for all of them."""

    kind = MachineKind.WEB_LINE
    moves = 0.05  #: m/s

    def __init__(
        self, model: ModelParameters, emulation: Emulation | None, cycle_s: float, spans: Sequence[int] | None = None
    ) -> None:
        self.configured, self.emulation = model, emulation
        self._spans = tuple(range(1, model.span_count + 1) if spans is None else spans)
        axes = range(1, model.axis_count + 1)
        self.speeds = tuple(f"v{axis}_m_s" for axis in axes)
        self.needed = (
            *(f"x{axis}_m" for axis in axes),
            *self.speeds,
            *(f"tau{axis}_Nm" for axis in axes),
            *("strain_prev", "F_next_N"),
        )
        self.estimated = tuple(f"E{models.numbered(model, span)}_sim_Pa" for span in self._spans)
        self.usual_Nm = np.array(
            [machine_sizes(model, k).force_N / model.motor_rad_per_m(k) for k in range(1, model.axis_count + 1)]
        )
        self._cycle_s = cycle_s

    def gap(self, model: Machine) -> ModelGap:
        """Residual generator of one model."""
        return ModelGap(models.line(model), self._spans, self._cycle_s)

    def estimate_of(self, model: Machine) -> Array:
        """E of each span in which it is estimated (M,) as the model has it, Pa."""
        return np.array([models.line(model).youngs_modulus_Pa(span) for span in self._spans])

    def with_estimate(self, model: Machine, estimate: Array) -> ModelParameters:
        """The model with another E in these spans (M,)."""
        moduli_Pa = dict(zip(self._spans, estimate.tolist(), strict=True))
        return models.with_moduli(models.line(model), moduli_Pa)

    def estimate_at(self, model: Machine, time_s: float) -> Array:
        """E in these spans (M,) as the model's effects make it at a time of theirs."""
        return np.array([models.modulus_at(model, span, time_s) for span in self._spans])

    def is_of_estimate(self, effect_id: str) -> bool:
        """True if an effect is a change of E."""
        return models.is_of_estimate(effect_id)

    def why_not_carried(self, effect_id: str) -> str:
        """Where it goes by a clock."""
        return why_not_carried(effect_id, self.kind)

    def without_estimate(self, model: Machine) -> ModelParameters:
        """The model without changes of E but for those that it was configured with."""
        return models.without_estimate(model, self.configured)

    def followed_from(self, window: Window, first: int) -> int:
        """Until all of its web is another one."""
        return first - segment.rows_of_travel(window, self.configured, first, exchanged_m(self.configured)) - SHORT

    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first cycle before which, for a while, neither speeds nor tensions change; None where there is none."""
        return segment.quiet_cycle(window, self.configured, first, end, self._cycle_s)

    def estimate_in(self, window: Window, model: Machine, known: Array, first: int, end: int) -> Array:
        """Keep the known estimate: what a line lacks looks like another E too often."""
        return known

    def data_of(self, window: Window, model: Machine, first: int, end: int, begun: int) -> Measured:
        """Measured data of these cycles, of what has begun in cycle `begun`: until then the web was strained as by
        the model. Raises UnusableInputError for what can't be diagnosed."""
        return segment.data_of(window, models.line(model), self.emulation, (begun, first, end), self._cycle_s)

    def packed(self, model: Machine) -> Array:
        """(P,): as a predictor takes it."""
        return segment.packed(models.line(model))
