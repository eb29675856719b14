"""What a machine is to the twin's process; listening, time, alarms and status are the same for all."""

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
#: What the bench last said of the machine's boundary, by the name of the signal (6413h).
BoundaryInputs = Callable[[str], float]


class TwinMachine(Protocol):
    """The closed model of a machine with its estimator."""

    @property
    def ports(self) -> Sequence[MotorPort]:
        """Of the model's motors, one for each virtual axis."""

    @property
    def plant(self) -> Plant:
        """The model."""

    @property
    def problem(self) -> Problem | None:
        """Why the last measurement could not be used."""

    @property
    def problems(self) -> Mapping[int, Problem | None]:
        """The same by the number of the span at which it is; of a machine with one, or without, under 0."""

    @property
    def shift_span(self) -> int:
        """Number of the span at which the torque has shifted, or is undecided, most; 0 where there is one, or none."""

    @property
    def refused(self) -> bool:
        """Whether a measured state was not plausible and was not taken over in the last cycle."""

    @property
    def synchronized(self) -> bool:
        """Whether what is estimated is known as well as the config asks for."""

    @property
    def separable(self) -> bool:
        """Whether the data tell everything that is estimated apart."""

    @property
    def torque_shift_Nm(self) -> float:
        """What the measured torque has shifted by, and is corrected for; 0 where nothing looks for it."""

    @property
    def torque_undecided(self) -> bool:
        """Whether the torque has changed, and nothing tells yet why."""

    def reset(self) -> None:
        """Start anew with what is assumed at the start, at rest."""

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Whether nobody knows how long a cycle is, as SYNC does not come as often as was believed: what is measured
        is followed then, and nothing is learned from it."""

    def set_cycle_time(self, cycle_s: float) -> None:
        """Each cycle is so long from the next on. Goes on from what was known when it was last but one said to `keep`
        it, and from where the machine is now."""

    def keep(self) -> None:
        """What is known now was found with cycles that are as long as is believed. A release does the same."""

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, under_way: bool = False) -> bool:
        """The drives have been enabled: take motion and torque of the axes (N,) over, from two cycles in a row.

        `under_way`: they were enabled already when the twin began. False where either measurement is of several
        instants: nothing is taken over.
        """

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Take what the axes (N,) measured at the instant that the model has been simulated to.

        False where the measurements are not of one instant: a `miss`.
        """

    def miss(self) -> None:
        """A cycle without measurement: the estimate is held."""

    def listen(self) -> None:
        """Take over what the bench says of the machine's boundary: it acts in the next step of the plant."""

    def use_method(self, number: int) -> None:
        """Go on with another method from the present estimate (2101h); 0: the configured one.

        Raises ValueError for a number that there is not.
        """

    def found(self) -> Sequence[EstimatedModelError]:
        """What is known by now of errors of the model."""

    def published(self) -> Sequence[float]:
        """What the virtual I/O shows now: one value for each signal of 6403h (`ProcessData.published`)."""

    @property
    def largest_steps(self) -> Sequence[float]:
        """Of each of these values by how much another model may change it from one cycle to the next; inf, or nothing
        where there are no more: by anything."""


#: What a machine in vectors has done in a cycle: gone on; the same, and what it reports may be another; gone on without
#: a measurement, as they were not of one instant.
WENT_ON, LOOK, MISSED = range(3)


@dataclass(frozen=True)
class MachineVectors:
    """Where a machine in vectors finds what it takes, and leaves what it shows; of N axes.

    `measured` (4 N,): position and torque of an axis in the first and third of its four; `asked` (N,), `shown` (5 N,):
    set points and feedback of the motors as of `hilbench.plant.interface.StepsInModes`. `values`: with what the bench
    says of the boundary at the places `boundary_places`, by signal, and what is published at `published`; `whole`: with
    number and status of the next SYNC at these places.
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
    """A released machine, with the model that it was configured with, while it goes on in vectors."""

    @property
    def piece(self) -> CompiledStage:
        """Of a cycle: `compare`, `listen`, a step of the plant, `published`, and the status for the next SYNC; another
        one once `go_on_from` has made its vectors others."""

    def has_ended(self, code: int) -> bool:
        """Whether with this the cycle has gone on to its end."""

    def go_on_from(self, code: int) -> int:
        """The rest of a cycle whose piece has returned this: WENT_ON, LOOK or MISSED."""

    def give(self) -> int:
        """The objects get what the vectors have; returns the status that was said at the last SYNC."""


@runtime_checkable
class VectorMachine(Protocol):
    """A machine that may go on in vectors."""

    @property
    def goes_in_vectors(self) -> bool:
        """Whether it does so as it is now."""

    def warm_up_in_vectors(self) -> None:
        """Compile, or load, what it runs on then."""

    def in_vectors(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> InVectors:
        """The machine in vectors; its objects are to be left alone until it gives. `fallback`: of its piece."""
