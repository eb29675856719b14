"""Measurements of a web line beside the motion of its driven rollers: tensions, positions of carriages, radii of reels.

And whether recorded torques can be those of their axes, by what accelerates an axis, and how a web pulls.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.smooth_motion import smoothed
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.line_inverse import required_torques
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import Reel, reel_name
from hilbench.results.recording import Recording

_TENSION: Final = "F_meas_N"
#: To which the position of a carriage is believed, m, and the radius of a reel, a share of that at the start.
_CARRIAGE_M, _RADIUS_SHARE = 2e-4, 2e-4


@dataclass(frozen=True)
class StationSensor:
    """Readings of the sensor of a carriage's position or a reel's radius."""

    channel: str
    measured_m: NDArray[np.float64]  #: (n,)
    known_to_m: float  #: by how much a right prediction may be off


def station_sensors(recording: Recording, model: Machine) -> dict[str, StationSensor]:
    """Readings of station sensors, where they are recorded, by the station's name."""
    if not isinstance(model, ModelParameters):
        return {}
    known = {each.station.name: (f"x_{each.station.name}_meas_m", _CARRIAGE_M) for each in model.carriages}
    for roller in model.line_rollers:
        if isinstance(roller.station, Reel) and roller.axis is not None:
            name = reel_name(roller.station)
            known[name] = (f"r_{name}_meas_m", _RADIUS_SHARE * model.radius_m(roller.axis))
    return {
        name: StationSensor(channel, np.asarray(recording[channel], np.float64), known_to_m)
        for name, (channel, known_to_m) in known.items()
        if channel in recording
    }


def carriage_forces(recording: Recording, model: Machine) -> dict[str, NDArray[np.float64]]:
    """Force commands of carriages that receive one, N, by the station's name."""
    carriages = model.carriages if isinstance(model, ModelParameters) else ()
    channels = {each.station.name: f"f_{each.station.name}_cmd_N" for each in carriages}
    return {
        name: np.asarray(recording[channel], np.float64) for name, channel in channels.items() if channel in recording
    }


def tension_channels(recording: Recording, spans: int) -> dict[int, str]:
    """Channels of measured tensions by span; that of the first is without its number where there is one span."""
    found: dict[int, str] = {}
    for span in range(1, spans + 1):
        numbered = f"F{span}_meas_N"
        names = [numbered] if span > 1 else [_TENSION, numbered] if spans == 1 else [numbered, _TENSION]
        if there := [name for name in names if name in recording]:
            found[span] = there[0]
    return found


def tension_names(spans: Iterable[int]) -> list[str]:
    """Names of the tensions of these spans in a diagnosis, in the order of the spans."""
    return [_TENSION if span == 1 else f"F{span}_meas_N" for span in sorted(spans)]


#: Corner up to which torque and acceleration are compared, Hz, rows of that, how many of them from the ends, and least
#: number of them.
SLOW_HZ: Final = 3.0
_SLOW_ROW_S, _FROM_ENDS, _LEAST_ROWS = 0.05, 10, 40
#: Deviations by which the torque's share of what accelerates the axis is certain; shares of the inertia from which it
#: is no effect.
_CERTAIN, _AGAINST, _MOST_INERTIA = 15.0, 0.3, 5.0
#: How many N·m a torque of 1 in another unit is, and the factor by which an axis may have another inertia all the same.
_UNITS: Final = ((1e3, "kN·m"), (1e-3, "mN·m"), (1e-2, "N·cm"))
_SAME_UNIT: Final = 2.0
#: Share of the sum of squares of two torques that is left where each is taken for the other's: then they are.
_EXCHANGED: Final = 0.1


@dataclass(frozen=True)
class SlowMotion:
    """Low-frequency motion and recorded torques of the axes: (n,) by axis."""

    x: dict[int, Array]  #: of axes with a position
    v: dict[int, Array]
    a: dict[int, Array]
    tau_Nm: dict[int, Array]
    rows: NDArray[np.intp]  #: those that are compared
    period_s: float

    @classmethod
    def of(
        cls, x: Mapping[int, Array], v: Mapping[int, Array], tau_Nm: Mapping[int, Array], period_s: float, usable: Rows
    ) -> SlowMotion:
        """Slow motion by positions, speeds where there are none, and torques; `usable` (n,): rows as they were
        measured."""
        band_Hz, step = (SLOW_HZ, 2.0 * SLOW_HZ), max(1, round(_SLOW_ROW_S / period_s))
        rows = np.flatnonzero(usable)[::step]
        rows = rows[(rows > step * _FROM_ENDS) & (rows < len(usable) - step * _FROM_ENDS)]
        found = cls({}, {}, {}, {}, rows, period_s)
        for axis, position in x.items():
            found.x[axis], found.v[axis], found.a[axis] = smoothed(position, period_s, 1, band_Hz, 2)
        for axis in set(v) - set(x):
            found.v[axis], found.a[axis] = smoothed(v[axis], period_s, 1, band_Hz, 1)
        for axis, torque in tau_Nm.items():
            (found.tau_Nm[axis],) = smoothed(torque, period_s, 1, band_Hz, 0)
        return found

    def inertia_share(self, axis: int, Nm_per_acceleration: float) -> float | None:
        """The recorded torque's share of what accelerates the axis by the model, where that is certain."""
        if axis not in self.v or axis not in self.tau_Nm or len(self.rows) < _LEAST_ROWS:
            return None
        v, a, torque = (values[axis][self.rows] for values in (self.v, self.a, self.tau_Nm))
        columns = np.column_stack([Nm_per_acceleration * a, v, np.sign(v), np.ones_like(v)])
        theta, _, rank, _ = np.linalg.lstsq(columns, torque, rcond=None)
        if rank < columns.shape[1]:  # at an even speed the inertia is not identifiable
            return None
        left = torque - columns @ theta
        deviation = float(np.std(left) * np.sqrt(np.linalg.pinv(columns.T @ columns)[0, 0]))
        return float(theta[0]) if abs(float(theta[0])) >= _CERTAIN * deviation else None


def unit_of(share: float) -> str | None:
    """The unit in which a torque is that share of what accelerates its axis; None where it may be N·m."""
    for Nm, unit in _UNITS:
        if abs(np.log(max(share, 1e-300) * Nm)) < np.log(_SAME_UNIT):
            return unit
    return None


def accelerates(share: float) -> bool:
    """True if a torque with that share of the inertia may be its axis' own, with an effect or without."""
    return -_AGAINST < share < _MOST_INERTIA


def exchanged(motion: SlowMotion, model: ModelParameters, boundary: Array) -> Iterator[tuple[int, int]]:
    """Pairs of axes of a line of which each has the torque that the other needs; boundary (n, 2) as of a recording."""
    axes = range(1, model.axis_count + 1)
    if not set(motion.x) >= set(axes) or len(motion.rows) < _LEAST_ROWS:
        return
    x, v, a = (np.column_stack([of[axis] for axis in axes]) for of in (motion.x, motion.v, motion.a))
    needed = required_torques(lay.pack(model), model, x, v, a, boundary, motion.period_s).tau_Nm[0][motion.rows]
    for one, two in combinations(sorted(motion.tau_Nm), 2):
        torques = np.column_stack([motion.tau_Nm[axis][motion.rows] for axis in (one, two)])
        both = needed[:, [one - 1, two - 1]]
        if np.sum((torques - both[:, ::-1]) ** 2) < _EXCHANGED * np.sum((torques - both) ** 2):
            yield one, two
