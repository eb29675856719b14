"""Sensors of stations: what they say beside what the line that is followed says, by what that depends on.

A dancer or accumulator has one of its position, a reel one of its radius, an idler a load cell: the mean of the
tensions on both sides of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import Idler, Reel, reel_name
from hilbench.plant.web_line.varied_line import Kind, Unknown, VariedLine

# How wrong they are, as standard deviations.
_CARRIAGE_M: Final = 2e-4
_RADIUS_SHARE: Final = 2e-4
#: Of the usual tension at a load cell: in each window, as idlers swing, and throughout.
_CELL_SHARE, _CELL_OFFSET_SHARE = 3e-3, 2e-3


class StationSensors:
    """Those of the stations that are `measured`, by name; `varied`: the line that is followed, with its n unknowns.

    Vectors (s,) are of the sensors: carriages, reels, then load cells.
    """

    def __init__(self, model: ModelParameters, varied: VariedLine, measured: Sequence[str]) -> None:
        self._model, self._varied = model, varied
        self._direct = [(name, unknown) for name, unknown in _stations(model).items() if name in measured]
        idlers = [row for row, each in enumerate(model.line_rollers) if isinstance(each.station, Idler)]
        names = [model.line_rollers[row].name for row in idlers]
        self._cells = [(name, number) for number, name in enumerate(names, 1) if name in measured]
        at_cells_N = [
            model.upstream_strain * 0.5 * (model.stiffness_N(row) + model.stiffness_N(row + 1))
            for row, name in zip(idlers, names, strict=True)
            if name in measured
        ]
        #: The usual tension at each load cell (s,); 0 for what is no tension.
        self.tensions_N = np.array([0.0] * len(self._direct) + at_cells_N)
        shares = [_CARRIAGE_M if unknown.kind is Kind.CARRIAGE else _RADIUS_SHARE for _, unknown in self._direct]
        noise = np.array(shares + [0.0] * len(at_cells_N))
        #: Variances of what they say in a window (s,), and deviations of their constant errors (s,).
        self.variances = (noise + _CELL_SHARE * self.tensions_N) ** 2
        self.offsets = _CELL_OFFSET_SHARE * self.tensions_N

    @property
    def sensed(self) -> list[Unknown]:
        """The unknowns that have a sensor of their own."""
        return [unknown for _, unknown in self._direct]

    def left(self, told: Mapping[str, float]) -> Vector:
        """What they say, by name of the station, less what the line that is followed does (s,)."""
        found = []
        for name, unknown in self._direct:
            if unknown.kind is Kind.CARRIAGE:
                found.append(told[name] - self._varied.carriage_m(unknown.number))
            else:
                found.append(told[name] / self._model.radius_m(unknown.number) - self._varied.ratio(unknown.number))
        return np.array(found + [told[name] - self._varied.cell_N(number) for name, number in self._cells])

    def slopes(self) -> Vector:
        """How what they say depends on each unknown (s, n)."""
        found = np.zeros((len(self.variances), len(self._varied.unknowns)))
        for at, (_, unknown) in enumerate(self._direct):
            if unknown.kind is Kind.CARRIAGE:
                found[at] = self._varied.carriage_slopes(unknown.number)
            else:
                found[at, self._varied.places[unknown]] = 1.0
        for at, (_, number) in enumerate(self._cells, len(self._direct)):
            found[at] = self._varied.cell_slopes(number)
        return found


def _stations(model: ModelParameters) -> dict[str, Unknown]:
    """Those whose position or radius may have a sensor, by name, and what it measures."""
    found = {each.station.name: Unknown(Kind.CARRIAGE, at) for at, each in enumerate(model.carriages, 1)}
    for roller in model.line_rollers:
        if isinstance(roller.station, Reel) and roller.axis is not None:
            found[reel_name(roller.station)] = Unknown(Kind.RADIUS, roller.axis)
    return found
