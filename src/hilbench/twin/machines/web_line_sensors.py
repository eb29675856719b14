"""Station sensors: their residuals to the simulated line, and the sensitivities of those.

A dancer or accumulator has a position sensor, a reel one of its radius, an idler a load cell: the mean of the tensions
on both sides of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from hilbench.compiled import Vector
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sensitivity_model import Kind, SensitivityModel, Unknown
from hilbench.plant.web_line.stations import Idler, Reel, reel_name

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
        self._varied = sensitivities
        direct = [(name, unknown) for name, unknown in _stations(model).items() if name in measured]
        idlers = {each.name: row for row, each in enumerate(model.line_rollers) if isinstance(each.station, Idler)}
        cells = {name: row for name, row in idlers.items() if name in measured}
        #: Unknowns with a sensor of their own.
        self.sensed = [unknown for _, unknown in direct]
        self._names = [name for name, _ in direct] + list(cells)
        count = len(self._names)
        # Sensitivities of each sensor to integrated states and tensions of a line, and to radii of reels.
        self._of_motions = np.zeros((count, sensitivities.motion_count))
        self._of_tensions, self._of_ratios = np.zeros((count, model.span_count)), np.zeros((count, model.axis_count))
        self._own, self._scales = np.zeros((count, len(sensitivities.unknowns))), np.ones(count)
        for at, unknown in enumerate(self.sensed):
            if unknown.kind is Kind.CARRIAGE:
                self._of_motions[at, sensitivities.carriage_row(unknown.number)] = 1.0
            else:
                self._of_ratios[at, unknown.number - 1] = self._own[at, sensitivities.places[unknown]] = 1.0
                self._scales[at] = model.radius_m(unknown.number)
        for at, row in enumerate(cells.values(), len(direct)):
            self._of_tensions[at, [row - 1, row]] = 0.5
        #: Usual tension at each load cell (s,); 0 for other sensors.
        stiffness_N = np.array([model.stiffness_N(span) for span in range(1, model.span_count + 1)])
        self.tensions_N = model.upstream_strain * self._of_tensions @ stiffness_N
        shares = [_CARRIAGE_M if unknown.kind is Kind.CARRIAGE else _RADIUS_SHARE for unknown in self.sensed]
        noise = np.array(shares + [0.0] * len(cells))
        #: Variances of the readings in a window (s,), and deviations of their constant errors (s,).
        self.variances = (noise + _CELL_SHARE * self.tensions_N) ** 2
        self.offsets = _CELL_OFFSET_SHARE * self.tensions_N

    def look(self, readings: Mapping[str, float]) -> tuple[Vector, Vector]:
        """Residuals of the readings, by station name, to the simulated line (s,), and their sensitivities to each
        unknown (s, n)."""
        shown, slopes = self._varied.shown(self._of_motions, self._of_tensions)
        readings_now = np.array([readings[name] for name in self._names]) / self._scales
        return readings_now - shown - self._of_ratios @ self._varied.ratios, slopes + self._own


def _stations(model: ModelParameters) -> dict[str, Unknown]:
    """Stations whose position or radius may have a sensor, by name, with the unknown it measures."""
    found = {each.station.name: Unknown(Kind.CARRIAGE, at) for at, each in enumerate(model.carriages, 1)}
    for roller in model.line_rollers:
        if isinstance(roller.station, Reel) and roller.axis is not None:
            found[reel_name(roller.station)] = Unknown(Kind.RADIUS, roller.axis)
    return found
