"""Prediction of a recording's measured signals from a parameter vector, and which one is chosen."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.coupling import Arm
from hilbench.diagnosis.loop_check import Loop
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.noise import floor
from hilbench.diagnosis.residual_analysis import Condition
from hilbench.machine_kinds import machine_part
from hilbench.plant.model_file import Machine

#: Basis of a free run.
RECORDED_COMMANDS: Final = "the recorded commands"
#: Share of a cycle by which a row of a bench's recording may be off the cycles.
_UNEVEN_CYCLES: Final = 1e-6


class Predictor(ABC):
    """Prediction of a recording's signals that a diagnosis can use."""

    names: tuple[str, ...]  #: of the signals
    measured: Array  #: (signals, n)
    rows: Rows  #: (n,): those that count
    tolerances: Array  #: (signals,): possible error of each signal in addition to its noise
    every: int = 1  #: rows of the recording per row of the prediction
    exact: bool = True  #: a right model leaves white noise and nothing else
    emulation: AnyEmulation | None = None  #: of web or shaft by a load motor; None where they were real
    arm: Arm | None = None  #: how a lone axis is coupled with another one; None: it is not

    @property
    def narrower(self) -> Predictor | None:
        """Prediction in half the band of frequencies; None where all are compared."""
        return None

    @property
    def surrogate(self) -> Predictor | None:
        """Cheaper prediction with nearly the same response to a change of parameters; None where there is none."""
        return None

    def floor(self, signal: int) -> float:
        """Standard deviation of the noise of a signal, from the recording alone."""
        return floor(self.measured[signal])

    @abstractmethod
    def conditions(self, parameters: Array) -> list[Condition]:
        """States that residuals may depend on, time first; (n,) each."""

    @abstractmethod
    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, signals, n)."""

    def doubts(self, parameters: Array) -> Array:
        """(shapes, signals, n): errors of a right prediction from parameters (P,) in addition to noise, each to one
        standard deviation."""
        return np.empty((0, *self.measured.shape))

    def quick(self, parameters: Array) -> Array | None:
        """(signals, n): how much more of the measured the quick part of the motion needs by parameters (P,) than by
        the model; None where nothing is taken from a measured motion's calm part."""
        return None

    def with_force(self, force_N: float, time_s: float) -> Predictor:
        """Prediction with a force against the motion of the last roller from a time on.

        Raises TypeError on a lone axis.
        """
        raise TypeError("the prediction of a lone axis, expected a web")


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
