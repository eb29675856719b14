"""A segment of a running bench, and how a model predicts it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.noise import rms
from hilbench.diagnosis.predictor import Predictor, choice, deviations_of, torques_of
from hilbench.live.machine import LiveMachine
from hilbench.live.window import Window
from hilbench.plant.model_file import Machine

#: Share of its noise by which the gap of a torque is smaller, at least, with a changed model.
_SHOWS: Final = 0.02


@dataclass(frozen=True)
class Segment:
    """Data from a cycle on, and their prediction by a model."""

    data: Measured
    predictor: Predictor

    @classmethod
    def of(cls, machine: LiveMachine, window: Window, model: Machine, first: int, end: int, begun: int) -> Segment:
        """The cycles from `first` to before `end`; `begun` as in `LiveMachine.data_of`. Raises UnusableInputError for
        what can't be diagnosed."""
        data = machine.data_of(window, model, first, end, begun)
        return cls(data, choice(model, data, machine.emulation).predictor)

    def residual(self, parameters: Array) -> Array:
        """(signals, n): measured less predicted."""
        return np.asarray(self.predictor.measured - self.predictor.predict(parameters[None])[0])

    def misfit(self, residual: Array) -> float:
        """Sum of squares of a residual in units of what a right model leaves, on the rows that count."""
        return float(np.sum((residual / deviations_of(self.predictor)[:, None])[:, self.predictor.rows] ** 2))


def shows_in_torque(segment: Segment, before: Array, after: Array) -> bool:
    """True if a change of the model reduces the gap of a torque: of residuals (signals, n) before and after it."""
    rows, predictor = segment.predictor.rows, segment.predictor
    less_Nm = {k: rms(before[k, rows]) - rms(after[k, rows]) for k in torques_of(predictor)}
    return any(less > _SHOWS * predictor.floor(k) for k, less in less_Nm.items())
