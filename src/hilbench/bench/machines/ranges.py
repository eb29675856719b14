"""Ranges within which an operator may change a running machine: the objects 2200h of the bench's own node."""

from __future__ import annotations

from typing import Final

from hilbench.bench.machines import web_line_ranges
from hilbench.machine_kinds import machine_part
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import (
    LINE_SPEED,
    MODEL_CHANGE,
    SHAFT_COULOMB_FRICTION,
    SHAFT_INERTIA,
    SPEED,
    permitted,
)

#: Sub-index of 2200h, given once and for all, and name in the EDS file of each quantity, by path.
OPERATOR_OBJECTS: Final = {
    LINE_SPEED: (1, "Line speed [m/s]"),
    SPEED: (4, "Speed of the shaft [rad/s]"),
    SHAFT_INERTIA: (5, "Inertia of the emulated shaft [kg.m2]"),
    SHAFT_COULOMB_FRICTION: (6, "Dry friction of the emulated shaft [N.m]"),
    MODEL_CHANGE: (8, "Proposed change of the twin's model: 1 go on with it, 0 do not"),
    **web_line_ranges.OBJECTS,
}


def operator_ranges(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Least and largest value by path of an object, SI: to where the config's limits warn, or trip
    where none warns; never beyond what the quantity may have at all (`hilbench.topology.quantities`)."""
    ranges: dict[str, tuple[float, float]] = machine_part(config.machine.kind, "ranges")(config)
    return {
        path: (max(low, permitted(path).lower), min(high, permitted(path).upper))
        for path, (low, high) in ranges.items()
        if path in OPERATOR_OBJECTS
    }
