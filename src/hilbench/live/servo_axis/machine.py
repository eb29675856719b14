"""A servo axis, as it is diagnosed while it runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.errors import UnusableInputError
from hilbench.live.machine import SHORT
from hilbench.live.models import why_not_carried
from hilbench.live.segment import Segment
from hilbench.live.servo_axis import models
from hilbench.live.servo_axis.gap import ShaftGap
from hilbench.live.window import Window
from hilbench.plant.effect import MachineKind
from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.sizes import machine_sizes

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

#: In which steps of its share the inertia's best value is looked for, and the largest of them at once.
_STEP: Final = 0.02
_MOST: Final = 0.5
#: Rows in a row that come late which push a shaft by more than noise, and for how long that shows, s.
_LATE, _PUSHED_S = 2, 0.15
#: Means that are followed before a gap is looked at.
_FOLLOWED: Final = 4


class LiveShaft:
    """A `LiveMachine` whose twin estimates the inertia. `emulation`: how the load motor emulates what is not there."""

    kind = MachineKind.SERVO_AXIS
    speeds = ("v1_rad_s",)
    needed = ("x1_rad", *speeds, "tau1_Nm")
    moves = 0.5  #: rad/s
    estimated = ("J_sim_kg_m2",)

    def __init__(self, model: ServoAxisParameters, emulation: ShaftEmulation | None, cycle_s: float) -> None:
        self.configured, self.emulation = model, emulation
        self.usual_Nm = np.array([machine_sizes(model).force_N])
        self._cycle_s = cycle_s

    def gap(self, model: Machine) -> ShaftGap:
        """Residual generator of one model."""
        return ShaftGap(models.shaft(model), self._cycle_s)

    def estimate_of(self, model: Machine) -> Array:
        """Inertia (1,) as the model has it, kg·m²."""
        return self.estimate_at(model, 0.0)

    def with_estimate(self, model: Machine, estimate: Array) -> ServoAxisParameters:
        """The model with another inertia (1,)."""
        return models.with_inertia(models.shaft(model), float(estimate[0]))

    def estimate_at(self, model: Machine, time_s: float) -> Array:
        """Inertia (1,) as the model's effects make it at a time of theirs."""
        of_shaft = models.shaft(model)
        return np.array([of_shaft.inertia_kg_m2 * models.inertia_factor(of_shaft, time_s)])

    def is_of_estimate(self, effect_id: str) -> bool:
        """True if an effect is a change of the inertia."""
        return models.is_of_estimate(effect_id)

    def why_not_carried(self, effect_id: str) -> str:
        """Where it goes by a clock."""
        return why_not_carried(effect_id, self.kind)

    def without_estimate(self, model: Machine) -> ServoAxisParameters:
        """The model with the inertia that it was configured with."""
        return models.without_estimate(models.shaft(model), self.configured)

    def followed_from(self, window: Window, first: int) -> int:
        """Some means before it."""
        return max(first - _FOLLOWED * SHORT, window.first)

    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first of the range that is kept: the shaft is where its commands are, whatever it does."""
        begin = max(first, window.first)
        return begin if begin < end else None

    def estimate_in(self, window: Window, model: Machine, known: Array, first: int, end: int) -> Array:
        """Inertia by the torques of its accelerations, fitted with a constant one and one in proportion to the
        speed."""
        segment = Segment.of(self, window, self.with_estimate(model, known), first, end, first)
        here, there = (
            segment.residual(self.packed(self.with_estimate(model, known * (1.0 + share))))[0] for share in (0.0, _STEP)
        )
        rows, speed = segment.predictor.rows, segment.data.commands_m_s[:, 0]
        columns = np.column_stack([(there - here) / _STEP, np.ones(len(here)), speed])[rows]
        share = -float(np.linalg.lstsq(columns, here[rows], rcond=None)[0][0])
        return np.asarray(known * (1.0 + float(np.clip(share, -_MOST, _MOST))))

    def data_of(self, window: Window, model: Machine, first: int, end: int, begun: int) -> Measured:
        """Measured data of these cycles, of a shaft, which has no memory of earlier ones. Raises UnusableInputError
        for what can't be diagnosed."""
        data = measured_from(window.recording(first, end), model, "the running bench")
        known = window.known(first, end)
        if len(known) != len(data.t_s):
            raise UnusableInputError("the running bench", "rows could not be placed in time, expected one each cycle")
        return replace(data, left_out=~known | data.left_out | self._pushed(window.measured(first, end)))

    def _pushed(self, measured: Rows) -> Rows:
        """(n,): several rows in a row that were not `measured` in time (n,), and those behind them. A load motor that
        does not hear from the bench goes on with the torque that it has, and pushes the shaft."""
        late = np.convolve(~measured, np.ones(_LATE), "valid") > _LATE - 0.5
        pushed = np.zeros(len(measured), bool)
        for row in np.flatnonzero(late):
            pushed[row : row + _LATE + round(_PUSHED_S / self._cycle_s)] = True
        return pushed

    def packed(self, model: Machine) -> Array:
        """(P,): as a predictor takes it."""
        return lay.pack(models.shaft(model))
