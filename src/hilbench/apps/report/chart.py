"""Contents of a picture: curves and bands over time in one or more sets of axes. `plots` draws it, `live` makes it
interactive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hilbench.arrays import Array

INK: Final = "#010203"  # becomes the page's text colour
BLUE: Final = "#0072b2"
VERMILLION: Final = "#d55e00"
GREEN: Final = "#009e73"
SKY: Final = "#56b4e9"
ORANGE: Final = "#e69f00"
PURPLE: Final = "#cc79a7"
BROWN: Final = "#8c6d31"
#: Of axes, spans and stations, in their order.
COLOURS: Final = (BLUE, GREEN, ORANGE, PURPLE, BROWN, SKY)

#: The variables of the page's style sheet that the colours are.
VARIABLES: Final = {
    INK: "--ink",
    BLUE: "--blue",
    VERMILLION: "--vermillion",
    GREEN: "--green",
    SKY: "--sky",
    ORANGE: "--orange",
    PURPLE: "--purple",
    BROWN: "--brown",
}


@dataclass(frozen=True)
class Curve:
    """A signal over time. `dash`: lengths of strokes and gaps; `spread`: a noisy one, drawn as an area on paper."""

    name: str
    t_s: Array
    values: Array
    colour: str
    width: float = 1.4
    dash: tuple[float, ...] = ()
    alpha: float = 1.0
    spread: bool = False


@dataclass(frozen=True)
class Band:
    """The area between two signals."""

    t_s: Array
    low: Array
    high: Array
    colour: str
    alpha: float


@dataclass(frozen=True)
class Chart:
    """One set of axes over time (s). `least`: height that is shown at least, in the unit of the axis."""

    y_label: str
    curves: Sequence[Curve]
    bands: Sequence[Band] = field(default=())
    least: float = 0.0

    @property
    def extent_s(self) -> tuple[float, float]:
        """First and last time of all curves."""
        return min(c.t_s[0] for c in self.curves), max(c.t_s[-1] for c in self.curves)

    def part(self, from_s: float, to_s: float) -> Chart:
        """Part of a chart in an interval; curves that have no two samples in it are left out."""
        curves, bands = [], []
        for curve in self.curves:
            part = _between(curve.t_s, from_s, to_s)
            if part.stop - part.start > 1:
                curves.append(replace(curve, t_s=curve.t_s[part], values=curve.values[part]))
        for band in self.bands:
            part = _between(band.t_s, from_s, to_s)
            bands.append(Band(band.t_s[part], band.low[part], band.high[part], band.colour, band.alpha))
        return Chart(self.y_label, curves, bands, self.least)


def _between(t_s: Array, from_s: float, to_s: float) -> slice:
    return slice(int(np.searchsorted(t_s, from_s)), int(np.searchsorted(t_s, to_s, side="right")))


@dataclass(frozen=True)
class Mark:
    """Something that happened: at one time, or from `start_s` to `end_s` (a ramp). `number` of a step, "" else."""

    start_s: float
    end_s: float
    text: str
    number: str = ""

    @property
    def lasts(self) -> bool:
        """True if it is an area and no line."""
        return self.end_s > self.start_s and not self.number
