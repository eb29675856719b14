"""What an operator may change of a running machine, and how far: the objects 2200h of the bench's own node."""

from __future__ import annotations

from math import inf
from typing import Final

from hilbench.topology.config import BenchConfig, Limit
from hilbench.topology.quantities import LINE_SPEED, TENSION_SET_POINT, YOUNGS_MODULUS, permitted

#: Sub-index of 2200h, given once and for all, and name in the EDS file of each quantity, by path.
OPERATOR_OBJECTS: Final = {
    LINE_SPEED: (1, "Line speed [m/s]"),
    TENSION_SET_POINT: (2, "Tension set-point [N]"),
    YOUNGS_MODULUS: (3, "Modulus of the imitated web [Pa]"),
}

#: What E may be off the model's by where the config sets no limit.
_LARGEST_RATIO = 1e3


def operator_ranges(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Least and largest value by path, SI: to where the config's limits warn, or trip
    where none warns; never beyond what the quantity may have at all (`hilbench.topology.quantities`)."""
    return {
        path: (max(low, permitted(path).lower), min(high, permitted(path).upper))
        for path, (low, high) in _of_web_line(config).items()
    }


def _of_web_line(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Line speed (m/s), tension set-point (N), Young's modulus of the imitated web (Pa)."""
    limits = config.safety.limits

    def highest(limit: Limit) -> float:
        return limit.warning or limit.trip or inf

    speed_m_s, ratio = highest(limits.speed_m_s), min(highest(limits.estimate_ratio), _LARGEST_RATIO)
    modulus_Pa = config.web_line.required_web.youngs_modulus_Pa
    return {
        LINE_SPEED: (-speed_m_s, speed_m_s),
        TENSION_SET_POINT: (0.0, highest(limits.tension_N)),
        YOUNGS_MODULUS: (modulus_Pa / ratio, modulus_Pa * ratio),
    }
