"""Station sensors of a line: what they show of its twin, and their errors.

A dancer or accumulator has a position sensor, a reel one of its radius, an idler a load cell: the mean of the tensions
on both sides of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Final

import numpy as np

from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_carriages, section_length_m
from hilbench.plant.web_line.sensitivity_model import Kind, SensitivityModel, Unknown
from hilbench.plant.web_line.stations import Idler, Reel, reel_name
from hilbench.twin.machines.web_line_stations_cycle import SENSOR

# Sensor errors, as standard deviations.
_CARRIAGE_M: Final = 2e-4
#: Of a radius: 4 % of a strain of 8e-4. At 2e-4 a slip at a roller between two reels is booked as their radii.
_RADIUS_SHARE: Final = 3e-5
#: Of the usual tension at a load cell: per window, as idlers oscillate, and constant.
_CELL_SHARE, _CELL_OFFSET_SHARE = 3e-3, 2e-3


class StationSensors:
    """Sensors of the `measured` stations, by name; `sensitivities`: the simulated line, with its n unknowns.

    Vectors (s,) are of the sensors: carriages, reels, then load cells.
    """

    def __init__(self, model: ModelParameters, sensitivities: SensitivityModel, measured: Sequence[str]) -> None:
        direct = [(name, unknown) for name, unknown in _stations(model).items() if name in measured]
        idlers = {each.name: row for row, each in enumerate(model.line_rollers) if isinstance(each.station, Idler)}
        cells = {name: row for name, row in idlers.items() if name in measured}
        #: Unknowns with a sensor of their own.
        self.sensed = [unknown for _, unknown in direct]
        self.names = [name for name, _ in direct] + list(cells)
        rows = []
        for unknown in self.sensed:
            if unknown.kind is Kind.CARRIAGE:
                rows.append((1.0, sensitivities.carriage_row(unknown.number), -1, -1, -1))
            else:
                radius_m, own = model.radius_m(unknown.number), sensitivities.places[unknown]
                rows.append((radius_m, -1, -1, unknown.number - 1, own))
        rows += [(1.0, -1, row - 1, -1, -1) for row in cells.values()]
        self.rows = np.array(rows, SENSOR)  #: of the compiled cycle
        #: Whether it is of a carriage's position (s,), and most by which one oscillates when E changes: the web of its
        #: section is stretched by no more.
        self.of_carriages = self.rows["carriage"] >= 0.0
        stretched_m = [model.upstream_strain * section_length_m(model, axis) for axis in axes_before_carriages(model)]
        self.most_oscillation = np.full(len(rows), inf)
        self.most_oscillation[self.of_carriages] = [
            stretched_m[unknown.number - 1] for unknown in self.sensed if unknown.kind is Kind.CARRIAGE
        ]
        stiffness_N = np.array([model.stiffness_N(span) for span in range(1, model.span_count + 1)])
        half, sides = 0.5 * model.upstream_strain, ([row - 1, row] for row in cells.values())
        #: Usual tension at each load cell (s,); 0 for other sensors.
        self.tensions_N = np.array([0.0] * len(direct) + [(half * stiffness_N[both]).sum() for both in sides])
        shares = [_CARRIAGE_M if unknown.kind is Kind.CARRIAGE else _RADIUS_SHARE for unknown in self.sensed]
        noise = np.array(shares + [0.0] * len(cells))
        #: Variances of the readings in a window (s,), and deviations of their constant errors (s,).
        self.variances = (noise + _CELL_SHARE * self.tensions_N) ** 2
        self.offsets = _CELL_OFFSET_SHARE * self.tensions_N


def _stations(model: ModelParameters) -> dict[str, Unknown]:
    """Stations whose position or radius may have a sensor, by name, with the unknown it measures."""
    found = {each.station.name: Unknown(Kind.CARRIAGE, at) for at, each in enumerate(model.carriages, 1)}
    for roller in model.line_rollers:
        if isinstance(roller.station, Reel) and roller.axis is not None:
            found[reel_name(roller.station)] = Unknown(Kind.RADIUS, roller.axis)
    return found
