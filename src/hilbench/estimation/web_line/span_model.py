"""Protocol of the simulation that a span estimator updates: two rollers with a span."""

from __future__ import annotations

from typing import Protocol

from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_vectors import LineVectors


class SpanModel(Protocol):
    """Simulation of two rollers with a span between them: a `Line`, or two rollers of a longer one."""

    @property
    def vectors(self) -> LineVectors:
        """Vectors of the line."""

    @property
    def first_axis(self) -> int:
        """Index of the first of the two rollers, from 0."""

    @property
    def moduli(self) -> Vector:
        """Parameter index of E of the span and of those that follow it, and E's ratio to the span's; (2, S)."""

    @property
    def strain(self) -> Vector:
        """Strain of the span (1,)."""

    def parameter(self, name: str) -> float:
        """Present value of a parameter."""

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on."""

    def show(self) -> None:
        """Update the motors' feedback after a change of state in the vectors."""
