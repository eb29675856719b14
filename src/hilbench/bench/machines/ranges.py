"""Ranges within which an operator may change a running machine: the objects 2200h of the bench's own node."""

from __future__ import annotations

from math import inf
from typing import Final

from hilbench.bench.machines import web_line_ranges
from hilbench.plant.effect import MachineKind
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import (
    LINE_SPEED,
    MODEL_CHANGE,
    SHAFT_COULOMB_FRICTION,
    SHAFT_INERTIA,
    SPEED,
    TENSION_PROBE,
    TENSION_SET_POINT,
    permitted,
    tension_set_point,
)
from hilbench.topology.safety import Limit
from hilbench.topology.web_line_quantities import YOUNGS_MODULUS

#: Sub-index of 2200h, given once and for all, and name in the EDS file of each quantity, by path.
OPERATOR_OBJECTS: Final = {
    LINE_SPEED: (1, "Line speed [m/s]"),
    TENSION_SET_POINT: (2, "Tension set-point [N]"),
    YOUNGS_MODULUS: (3, "Modulus of the emulated web [Pa]"),
    SPEED: (4, "Speed of the shaft [rad/s]"),
    SHAFT_INERTIA: (5, "Inertia of the emulated shaft [kg.m2]"),
    SHAFT_COULOMB_FRICTION: (6, "Dry friction of the emulated shaft [N.m]"),
    TENSION_PROBE: (7, "Probe of the tension [0 or 1]"),
    MODEL_CHANGE: (8, "Proposed change of the twin's model: 1 go on with it, 0 do not"),
    **web_line_ranges.OF_EACH_SPAN,
}

#: What E may be off the model's by where the config sets no limit.
_LARGEST_RATIO = 1e3


def operator_ranges(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Least and largest value by path, SI: to where the config's limits warn, or trip
    where none warns; never beyond what the quantity may have at all (`hilbench.topology.quantities`)."""
    ranges = _of_servo_axis(config) if config.machine_kind is MachineKind.SERVO_AXIS else _of_web_line(config)
    return {
        path: (max(low, permitted(path).lower), min(high, permitted(path).upper))
        for path, (low, high) in ranges.items()
    }


def _highest(limit: Limit) -> float:
    return limit.warning or limit.trip or inf


def _of_web_line(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Line speed (m/s), tension set-point (N), Young's modulus of the emulated web (Pa)."""
    limits = config.safety.limits
    speed_m_s, ratio = _highest(limits.speed_m_s), min(_highest(limits.estimate_ratio), _LARGEST_RATIO)
    moduli_Pa = web_line_ranges.moduli_Pa(config)
    set_points = [tension_set_point(config.shape.numbered(span)) for span in config.set_point_controls]
    return {
        **({} if config.twin.live_diagnosis is None else {MODEL_CHANGE: (0.0, 1.0)}),
        LINE_SPEED: (-speed_m_s, speed_m_s),
        **{path: (0.0, _highest(limits.tension_N)) for path in set_points if path in OPERATOR_OBJECTS},
        **{path: (E / ratio, E * ratio) for path, E in moduli_Pa.items() if path in OPERATOR_OBJECTS},
        **({TENSION_PROBE: (0.0, 1.0)} if config.tension_controls else {}),
    }


def _of_servo_axis(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Speed (rad/s), inertia (kg·m²) and dry friction (N·m) of the emulated shaft."""
    limits, model = config.safety.limits, config.servo_axis
    speed_rad_s, ratio = _highest(limits.speed_rad_s), min(_highest(limits.estimate_ratio), _LARGEST_RATIO)
    return {
        SPEED: (-speed_rad_s, speed_rad_s),
        SHAFT_INERTIA: (model.inertia_kg_m2 / ratio, model.inertia_kg_m2 * ratio),
        SHAFT_COULOMB_FRICTION: (0.0, _highest(limits.torque_Nm)),
    }
