"""Ranges and object places of the settable quantities of each span of a web line."""

from __future__ import annotations

from typing import Final

from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import LINE_SPEED, MODEL_CHANGE
from hilbench.topology.safety import LARGEST_RATIO
from hilbench.topology.web_line_quantities import (
    TENSION_PROBE,
    TENSION_SET_POINT,
    YOUNGS_MODULUS,
    modulus_of_span,
    spans_of_moduli,
    tension_set_point,
)

_FIRST_SET_POINT: Final = 15  #: sub-index of 2200h before that of span 1 on a line of several spans
_FIRST_MODULUS: Final = 31  #: sub-index before that of E of span 1
_MOST_SPANS: Final = 16  #: of how many spans there is an object of each

#: Sub-index of 2200h, given once and for all, and name in the EDS file, by path.
OBJECTS: Final = {
    TENSION_SET_POINT: (2, "Tension set-point [N]"),
    YOUNGS_MODULUS: (3, "Modulus of the emulated web [Pa]"),
    TENSION_PROBE: (7, "Probe of the tension [0 or 1]"),
    **{
        tension_set_point(str(span)): (_FIRST_SET_POINT + span, f"Tension set-point of span {span} [N]")
        for span in range(1, _MOST_SPANS + 1)
    },
    **{
        modulus_of_span(span): (_FIRST_MODULUS + span, f"Modulus of the emulated web in span {span} [Pa]")
        for span in range(1, _MOST_SPANS + 1)
    },
}


def ranges(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Line speed (m/s), tension set-point (N), Young's modulus of the emulated web (Pa)."""
    limits, model = config.safety.limits, config.web_line
    moduli_Pa = {path: model.youngs_modulus_Pa(span) for path, span in spans_of_moduli(config.shape).items()}
    speed_m_s, ratio = limits.speed_m_s.highest, min(limits.estimate_ratio.highest, LARGEST_RATIO)
    set_points = [tension_set_point(config.shape.numbered(span)) for span in config.set_point_controls]
    return {
        **({} if config.twin.live_diagnosis is None else {MODEL_CHANGE: (0.0, 1.0)}),
        LINE_SPEED: (-speed_m_s, speed_m_s),
        **dict.fromkeys(set_points, (0.0, limits.tension_N.highest)),
        **{path: (E / ratio, E * ratio) for path, E in moduli_Pa.items()},
        **({TENSION_PROBE: (0.0, 1.0)} if config.tension_controls else {}),
    }
