"""Web measurements other than those of driven rollers: tensions, positions of carriages, radii of reels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.plant.model_file import Machine
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
