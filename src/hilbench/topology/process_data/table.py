"""The process data of the virtual I/O: which signal is which REAL32 of the CiA-401 device, in which PDO."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Final

#: CiA 401: read analogue input float, what the twin publishes; write analogue output float, what it is sent.
INPUTS: Final = 0x6403
OUTPUTS: Final = 0x6413
#: Number of the TPDO that says of which SYNC the data are, and whether they can be trusted (2100h).
STATUS_TPDO: Final = 3
#: REAL32 that a PDO holds.
PER_PDO: Final = 2
#: SYNCs between two PDOs that say how sure an estimate is.
QUALITY_EVERY: Final = 10


@dataclass(frozen=True, slots=True)
class IoSignal:
    """One value: the signal by its name, its object, and what it is in an EDS file."""

    name: str
    index: int
    sub: int
    text: str


@dataclass(frozen=True, slots=True)
class IoPdo:
    """A PDO with process data: its number as TPDO or RPDO, from 1, its signals in order, every how many SYNCs."""

    number: int
    signals: tuple[IoSignal, ...]
    every: int = 1


@dataclass(frozen=True, slots=True)
class SimulatedTorque:
    """A simulated torque, which is in no PDO: it is the measured one of its axis (from 1) minus the residual.

    `name`, `residual`: names of the signals.
    """

    axis: int
    name: str
    residual: str


@dataclass(frozen=True, slots=True)
class ProcessData:
    """Process data between the bench and the twin of a machine.

    `published`: signals of 6403h in the order of their sub-indices; `boundary_inputs`: those of 6413h, none for a
    machine with nothing around it; `sent`: TPDOs, without the status.
    """

    published: tuple[IoSignal, ...]
    boundary_inputs: tuple[IoSignal, ...]
    sent: tuple[IoPdo, ...]
    torques: tuple[SimulatedTorque, ...]

    @property
    def boundary(self) -> tuple[IoPdo, ...]:
        """RPDOs with the twin's boundary inputs, in their order; none where there are no inputs."""
        pairs = [self.boundary_inputs[at : at + PER_PDO] for at in range(0, len(self.boundary_inputs), PER_PDO)]
        return tuple(IoPdo(number, pair) for number, pair in enumerate(pairs, 1))

    @property
    def state(self) -> Iterator[IoSignal]:
        """Signals that the twin sends with every SYNC."""
        return chain.from_iterable(pdo.signals for pdo in self.sent if pdo.every == 1)
