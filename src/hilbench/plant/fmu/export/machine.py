"""Machine definition for export: its start vectors, and the offsets of variables in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from hilbench.arrays import Vector
from hilbench.plant.interface import Quantity

P, S, U, OUT = "P", "S", "U", "OUT"
#: Vector of a state element that is set to 0 before each step: a limit flag is that of the step.
FORGOTTEN: Final = "NONE"


@dataclass(frozen=True, slots=True)
class Place:
    """Element of a vector; divided by `scale` it is the value of a variable in its SI unit."""

    vector: str
    index: int
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class ExportedVariable:
    """Variable of the FMU: an ``input``, ``output`` or ``parameter``, at one place or several."""

    quantity: Quantity
    causality: str
    places: tuple[Place, ...]


@dataclass(frozen=True)
class Kernel:
    """Step function of an exported FMU, to be compiled: ``go(p, s, u, w, out, samples, duration)``.

    Parameters, state, inputs, scratch space and observed values then; of a machine with drives `samples` of their
    sample times, else `duration` in s; 0 only observes. No array is counted or allocated in it (`hilbench.compiled`),
    so that it needs nothing of Python when it runs.
    """

    name: str
    function: Callable[..., None]


@dataclass(frozen=True)
class ExportedMachine:
    """Machine as exported to an FMU. `sample_s`: communication steps are multiples of it; 0: of any length."""

    name: str
    description: str
    kernel: Kernel
    p: Vector
    s: Vector
    u: Vector
    work: int
    out: int
    variables: tuple[ExportedVariable, ...]
    forgotten: tuple[Place, ...]
    sample_s: float
    time: tuple[int, float]  #: offset of the time in the state, and its value per second

    def start(self, variable: ExportedVariable) -> float:
        """Start value of an input or parameter."""
        place = variable.places[0]
        vector = {P: self.p, S: self.s, U: self.u}[place.vector]
        return float(vector[place.index] / place.scale)


def output(quantity: Quantity, column: int) -> ExportedVariable:
    """Output variable in a column of the observed values."""
    return ExportedVariable(quantity, "output", (Place(OUT, column),))


def parameter(quantity: Quantity, *places: Place) -> ExportedVariable:
    """Tunable parameter at these places."""
    return ExportedVariable(quantity, "parameter", places)


def asked(axis: int, unit: str, place: Place, *, drives: bool) -> ExportedVariable:
    """Set-point input of a motor: with its drive's loops a speed, else a torque; positions are in `unit`."""
    if drives:
        quantity = Quantity(f"v{axis}_cmd_{unit}_s", f"{unit}/s", f"velocity command of axis {axis}")
    else:
        quantity = Quantity(f"tau{axis}_cmd_Nm", "N·m", f"torque of the motor of axis {axis}, forward")
    return ExportedVariable(quantity, "input", (place,))
