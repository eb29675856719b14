"""A span and the web in it as they are measured: its strain by the encoders, pieces of other web, what it hands on."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.compiled import interpreted
from hilbench.estimation.web_line import span_estimator_cycle as cycle
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.splices import Piece

_as_if_stretched = interpreted(cycle.equivalent_strain)


class MeasuredSpan:
    """Of this balance; `t`: the state of the tracking (`tracking_cycle.SIZE`,), both as they go on."""

    def __init__(self, balance: MeasuredBalance, t: Vector) -> None:
        self._balance, self._t = balance, t

    @property
    def strain(self) -> float:
        """Of the web in the span, as the encoders show it."""
        return self._balance.web.first_strain

    @property
    def series_factor(self) -> float:
        """What pieces of other web make of E of the span, as springs in series."""
        return self._t.item(cycle.SERIES_FACTOR)

    @property
    def leaving_strain(self) -> float:
        """Of the web that leaves the span: all of it pulls alike, and each piece has its strain."""
        return self.strain * self.series_factor / self._t.item(cycle.END_FACTOR)

    @property
    def creep_ratio(self) -> float:
        """Share by which less web leaves the span than the roller behind it turns, as it creeps."""
        return self._t.item(cycle.CREEP_RATIO)

    @property
    def outlet_strain(self) -> float:
        """With which the next span gets it; see `tracking_cycle.outlet_strain`."""
        return _as_if_stretched(self.leaving_strain, self.creep_ratio)

    @property
    def reverse_outlet_strain(self) -> float:
        """With which the span before gets it in reverse; see `tracking_cycle.reverse_outlet_strain`."""
        return self.strain * self.series_factor

    @property
    def unstretched_m(self) -> float:
        """Web in the span, as long as it is without strain."""
        return self._balance.span_length_m / (1.0 + self.strain)

    @property
    def length_m(self) -> float:
        """Between the rollers."""
        return self._balance.span_length_m

    @property
    def mass_kg(self) -> float:
        """At the web, of what is behind the span."""
        return self._balance.mass_kg

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Let these be the pieces of other web in the span, by the way of the roller before it."""
        t, web = self._t, self._balance.web
        web.put_pieces(pieces)
        t[cycle.SPLICED] = bool(pieces)
        t[cycle.SERIES_FACTOR], t[cycle.END_FACTOR] = web.spliced_spans[0]
