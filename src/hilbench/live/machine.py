"""What a kind of machine brings to the live diagnosis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Generic, Protocol

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis import machines
from hilbench.diagnosis.machines import AnyEmulation, AnyMachine
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.noise import rms
from hilbench.diagnosis.predictor import Predictor, choice, deviations_of, torques_of
from hilbench.errors import UnusableInputError
from hilbench.live.window import Window
from hilbench.plant.model_file import Machine

#: Cycles of a mean of a gap.
SHORT: Final = 10


class Gap(Protocol):
    """Residual between measurement and one model, in N·m at the motor of each axis (N,)."""

    def restart(self) -> None:
        """The next rows are not those that follow the last."""

    def use_estimate(self, estimate: Array) -> None:
        """Use the twin's estimates (M,) from now on."""

    def follow(self, channels: Mapping[str, Array], known: Rows) -> Array:
        """(n // SHORT, N): of the next rows (n,) of `LiveMachine.needed`; n a multiple. NaN where nothing is known."""


class LiveMachine(ABC, Generic[AnyMachine]):
    """One machine of N axes, as it was configured; `emulation` by load motors, None where the machine is real. What the
    twin estimates are M numbers, in units of their signals."""

    moves: ClassVar[float]  #: speed below which friction is not one law but many
    speeds: Sequence[str]  #: channels of the axes
    needed: Sequence[str]  #: signals that a gap is made from, and `speeds`
    usual_Nm: Array  #: (N,) torques that are usual at the motors
    estimated: Sequence[str]  #: the signals of what the twin estimates (M,)

    def __init__(self, configured: AnyMachine, emulation: AnyEmulation | None, cycle_s: float) -> None:
        self.configured, self.emulation, self.cycle_s = configured, emulation, cycle_s

    @abstractmethod
    def gap(self, model: AnyMachine) -> Gap:
        """Residual generator of one model."""

    def estimate_of(self, model: AnyMachine) -> Array:
        """(M,) as the model has it."""
        return self.estimate_at(model, 0.0)

    @abstractmethod
    def with_estimate(self, model: AnyMachine, estimate: Array) -> AnyMachine:
        """The model with another one (M,)."""

    @abstractmethod
    def estimate_at(self, model: AnyMachine, time_s: float) -> Array:
        """(M,) as the model's effects make it at a time of theirs."""

    @abstractmethod
    def is_of_estimate(self, effect_id: str) -> bool:
        """True if an effect is a change of what the twin estimates anyway."""

    def without_estimate(self, model: AnyMachine) -> AnyMachine:
        """The model without changes of it but for those that it was configured with."""
        entries = [entry for entry in model.effects if not self.is_of_estimate(entry.effect)]
        own = [entry for entry in self.configured.effects if self.is_of_estimate(entry.effect)]
        return machines.with_effects(self.configured, [*own, *entries])

    @abstractmethod
    def followed_from(self, window: Window, first: int) -> int:
        """The cycle from which on a gap has to be followed to be known from cycle `first` on."""

    @abstractmethod
    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first cycle of a range at which a prediction can begin; None where there is none yet."""

    def estimate_in(self, window: Window, model: AnyMachine, known: Array, first: int, end: int) -> Array:
        """(M,) what these cycles tell of it, whatever else the model lacks; `known` where they tell nothing beyond
        that. Raises UnusableInputError for what can't be diagnosed."""
        return known

    def data_of(self, window: Window, model: AnyMachine, first: int, end: int, begun: int) -> Measured:
        """Measured data of these cycles, for an effect that began in cycle `begun`; before that the model held.
        Raises UnusableInputError for what can't be diagnosed."""
        data = measured_from(window.recording(first, end), model, "the running bench")
        known = window.known(first, end)
        if len(known) != len(data.t_s):
            raise UnusableInputError("the running bench", "rows could not be placed in time, expected one each cycle")
        return replace(data, left_out=~known | data.left_out)

    @abstractmethod
    def steady(self, chunk_s: float) -> tuple[float, dict[str, float]]:
        """A speed at which the watch looks at the second chunk, each of so many s, and what else does not change then,
        by channel."""


#: Share of its noise by which the gap of a torque is smaller, at least, with a changed model.
_SHOWS: Final = 0.02


@dataclass(frozen=True)
class Segment:
    """Data from a cycle on, and their prediction by a model."""

    data: Measured
    predictor: Predictor

    @classmethod
    def of(
        cls, machine: LiveMachine[AnyMachine], window: Window, model: AnyMachine, first: int, end: int, begun: int
    ) -> Segment:
        """The cycles from `first` to before `end`; `begun` as in `LiveMachine.data_of`. Raises UnusableInputError for
        what can't be diagnosed."""
        data = machine.data_of(window, model, first, end, begun)
        return cls(data, choice(model, data, machine.emulation).predictor)

    def residual(self, model: Machine) -> Array:
        """(signals, n): measured less predicted."""
        return np.asarray(self.predictor.measured - self.predictor.predict(machines.packed(model)[None])[0])

    def misfit(self, residual: Array) -> float:
        """Sum of squares of a residual in units of what a right model leaves, on the rows that count."""
        return float(np.sum((residual / deviations_of(self.predictor)[:, None])[:, self.predictor.rows] ** 2))

    def shows_in_torque(self, before: Array, after: Array) -> bool:
        """True if a change of the model reduces the gap of a torque: of residuals (signals, n) before and after it."""
        rows, predictor = self.predictor.rows, self.predictor
        less_Nm = {k: rms(before[k, rows]) - rms(after[k, rows]) for k in torques_of(predictor)}
        return any(less > _SHOWS * predictor.floor(k) for k, less in less_Nm.items())
