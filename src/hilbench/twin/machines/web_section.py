"""Section of a line that shows E of one span: the roller before it, and all after it as one roller.

That one has the mass of all (`hilbench.estimation.web_line.rollers`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hilbench.estimation.web_line.rollers import Rollers, two_rollers
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_vectors import LineVectors
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import YOUNGS_MODULUS


class WebSection:
    """Rollers `span` and those after it of a line, as a line of two rollers (see `SpanModel`).

    `rollers`: measurements of the line's rollers; `along`: spans whose E follows
    that of the section's, in the ratio of the model. Of a line of two rollers it is the line itself.
    """

    def __init__(
        self,
        model: ModelParameters,
        line: Line,
        span: int,
        rollers: Rollers,
        along: Iterable[int] = (),
    ) -> None:
        self._line = line
        self._span = span
        self._several = model.span_count > 1
        own_Pa = model.youngs_modulus_Pa(span)
        #: E of the spans that follow, over that of the section, by the model.
        self._ratios = {k: model.youngs_modulus_Pa(k) / own_Pa for k in (span, *along)}
        self.model = two_rollers(model, span, rollers.masses_behind_kg(span + 1))

    def parameter(self, name: str) -> float:
        """Parameter of the line; E is that of the section's span."""
        if name == YOUNGS_MODULUS.name and self._several:
            name = f"span{self._span}.youngs_modulus_Pa"
        return self._line.parameter(name)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter of the line; E of the section's span, and in proportion that of the spans along."""
        if name == YOUNGS_MODULUS.name and self._several:
            for of_span, ratio in self._ratios.items():
                self._line.set_parameter(f"span{of_span}.youngs_modulus_Pa", ratio * value)
        else:
            self._line.set_parameter(name, value)

    @property
    def vectors(self) -> LineVectors:
        """Vectors of the line."""
        return self._line.vectors

    @property
    def first_axis(self) -> int:
        """Index of the roller before the span, from 0."""
        return self._span - 1

    @property
    def moduli(self) -> Vector:
        """Parameter indices of E of the section's span and of those along, and its ratios; (2, S)."""
        spans = [span - 1 for span in self._ratios]
        return np.array([self._line.moduli[0, spans], list(self._ratios.values())])

    def show(self) -> None:
        """Update the motors' feedback after a change of state in the vectors."""
        self._line.show()

    @property
    def strain(self) -> Vector:
        """Strain of the span (1,)."""
        return self._line.strain[self._span - 1 : self._span]
