"""Interface of a machine to the twin's process; reception, time, alarms and status are common to all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hilbench.cycle_program import CompiledStage
from hilbench.estimation.problems import Problem
from hilbench.plant.interface import Plant
from hilbench.plant.motor_port import MotorPort
from hilbench.twin.estimated_errors import EstimatedModelError

#: Position in rad and torque in N·m of one axis, at the motor.
Measured = tuple[float, float]
#: Boundary input last stated by the bench, by the name of the signal (6413h).
BoundaryInputs = Callable[[str], float]


class TwinMachine(Protocol):
    """Closed-loop model of a machine with its estimator."""

    @property
    def ports(self) -> Sequence[MotorPort]:
        """Ports of the model's motors, one for each virtual axis."""

    @property
    def plant(self) -> Plant:
        """Model of the plant."""

    @property
    def problem(self) -> Problem | None:
        """Reason why the last measurement could not be used, if any."""

    @property
    def problems(self) -> Mapping[int, Problem | None]:
        """Problems by span number; under 0 for a machine with one span, or none."""

    @property
    def shift_span(self) -> int:
        """Number of the span with the largest (or an undecided) torque shift; 0 with one span, or none."""

    @property
    def refused(self) -> bool:
        """True if a measured state was implausible in the last cycle and was not transferred."""

    @property
    def synchronized(self) -> bool:
        """True if the estimate is as certain as configured."""

    @property
    def separable(self) -> bool:
        """True if the data separate all estimated parameters."""

    @property
    def torque_shift_Nm(self) -> float:
        """Shift of the measured torque that is compensated; 0 without detection."""

    @property
    def torque_undecided(self) -> bool:
        """True if the torque has changed for a reason that is still undecided."""

    def reset(self) -> None:
        """Reset to the initial assumptions, at rest."""

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze parameter adaptation while the SYNC period is uncertain; state tracking goes on."""

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time. Parameters are restored from the last-but-one checkpoint (`keep`); the machine state is
        kept."""

    def keep(self) -> None:
        """Take a checkpoint of the estimate: the cycle time is as assumed. A release does the same."""

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, in_motion: bool = False) -> bool:
        """Release the machine after the drives were enabled: take over motion and torque of the axes (N,), from two
        cycles in a row.

        `in_motion`: they were enabled already when the twin began. False if either measurement is incoherent (of
        several instants): nothing is taken over.
        """

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Take the axes' (N,) measurements at the instant that the model has been simulated to.

        False if they are not coherent (of one instant): a `miss`.
        """

    def miss(self) -> None:
        """Hold the estimate in a cycle without measurement."""

    def listen(self) -> None:
        """Read the boundary inputs; they act in the next step of the plant."""

    def use_method(self, number: int) -> None:
        """Switch to another method from the present estimate (2101h); 0: the configured one.

        Raises ValueError for an unknown number.
        """

    def found(self) -> Sequence[EstimatedModelError]:
        """Estimated errors of the model."""

    def published(self) -> Sequence[float]:
        """Outputs of the virtual I/O: one value for each signal of 6403h (`ProcessData.published`)."""

    @property
    def largest_steps(self) -> Sequence[float]:
        """Largest step of each output by a model switch, from one cycle to the next; inf, or absent: unlimited."""


class OneMethod:
    """`TwinMachine` with one method, whose estimates are signals: it finds no model errors and no torque shift."""

    refused, torque_undecided = False, False
    torque_shift_Nm, shift_span = 0.0, 0
    largest_steps: Sequence[float] = ()

    def found(self) -> Sequence[EstimatedModelError]:
        """Empty: estimates are published as signals."""
        return ()

    def use_method(self, number: int) -> None:
        """Raise ValueError for other than 0: there is no method to choose."""
        if number:
            raise ValueError(f"method {number}, expected 0: there is one method")


#: Result of a cycle in vectors: continued; continued, with a possibly changed report; continued without measurement, as
#: it was not coherent.
WENT_ON, LOOK, MISSED = range(3)


@dataclass(frozen=True)
class MachineVectors:
    """Process image of a machine in vectors, for N axes.

    `measured` (4 N,): position and torque of an axis in the first and third of its four; `asked` (N,), `shown` (5 N,):
    set points and feedback of the motors as of `hilbench.plant.interface.StepsInModes`. `values`: boundary inputs at
    the offsets `boundary_places`, by signal, and outputs at `published`; `whole`: number and status of the next SYNC at
    these offsets.
    """

    measured: NDArray[np.float64]
    asked: NDArray[np.float64]
    shown: NDArray[np.float64]
    values: NDArray[np.float64]
    boundary_places: Mapping[str, int]
    published: Sequence[int]
    whole: NDArray[np.int64]
    number: int
    status: int


class InVectors(Protocol):
    """Released machine with its configured model, running in vectors."""

    @property
    def piece(self) -> CompiledStage:
        """Compiled stage of `compare`, `listen`, a plant step, `published`, and the status for the next SYNC; replaced
        when `go_on_from` changes its vectors."""

    def go_on_from(self, code: int) -> int:
        """Run the rest of a cycle whose stage returned this code: WENT_ON, LOOK or MISSED."""

    def give(self) -> int:
        """Write the vectors back to the objects; returns the status published at the last SYNC."""


@runtime_checkable
class VectorMachine(Protocol):
    """Machine that can run in vectors."""

    @property
    def runs_in_vectors(self) -> bool:
        """True if it can do so in its present state."""

    @property
    def compiled_cycle(self) -> Callable[..., int]:
        """Entry point of its cycle, to be loaded in advance."""

    def in_vectors(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> InVectors:
        """Move the machine into vectors; its objects must not be used until `give`. `fallback`: of its stage."""
