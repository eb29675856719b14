"""What `tracking` needs of a simulation: two rollers with a span between them, and the motor of the second."""

from __future__ import annotations

from typing import Protocol

from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_vectors import LineVectors


class SpanModel(Protocol):
    """The simulation of two rollers with a span between them: a `Line`, or two rollers of one that has more."""

    @property
    def vectors(self) -> LineVectors:
        """What the line consists of."""

    @property
    def first_axis(self) -> int:
        """The first of the two rollers, from 0."""

    @property
    def moduli(self) -> Vector:
        """(2, S): where E of the span, and of those that go with it, stands in the parameters, and its ratio."""

    @property
    def strain(self) -> Vector:
        """Of the span (1,)."""

    def parameter(self, name: str) -> float:
        """Present value of a parameter."""

    def set_parameter(self, name: str, value: float) -> None:
        """Give a parameter a value from now on."""

    def show(self) -> None:
        """Bring what the motors show up to a state that was changed in the vectors."""


class SimulatedMotor(Protocol):
    """What shows a simulated torque: a `MotorPort`, or several motors as one."""

    @property
    def torque_Nm(self) -> float:
        """Motor side."""
