"""Measured span: its strain by the encoders, pieces of other web, and the strains at its ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.plant.web_line.splices import Piece


class MeasuredSpan:
    """Strains and lengths of a balance's web; `t`: live state of the span estimator, a `span_estimator_cycle.SPAN`."""

    def __init__(self, balance: MeasuredBalance, t: np.void) -> None:
        self._balance, self._t = balance, t

    @property
    def strain(self) -> float:
        """Strain of the web in the span, by the encoders."""
        return self._balance.web.strain.item(0)

    @property
    def series_factor(self) -> float:
        """Factor on E of the span by pieces of other web, as springs in series."""
        return float(self._t["series_factor"])

    @property
    def leaving_strain(self) -> float:
        """Strain of the web leaving the span: all pieces carry the same tension, each with its own strain."""
        return self.strain * self.series_factor / float(self._t["end_factor"])

    @property
    def unstretched_m(self) -> float:
        """Unstrained length of the web in the span."""
        return self._balance.span_length_m / (1.0 + self.strain)

    @property
    def length_m(self) -> float:
        """Length between the rollers."""
        return self._balance.span_length_m

    @property
    def mass_kg(self) -> float:
        """Mass at the web of the rollers after the span."""
        return self._balance.mass_kg

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Set the pieces of other web in the span, by the travel of the roller before it."""
        t, web = self._t, self._balance.web
        web.put_pieces(pieces)
        t["spliced"] = bool(pieces)
        t["series_factor"], t["end_factor"] = web.spliced_spans[0]
