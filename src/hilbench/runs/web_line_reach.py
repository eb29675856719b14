"""Range of a web line's commissioning: its speeds, two tensions of each controlled span, its ramps."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from hilbench.bench.machines.ranges import operator_ranges
from hilbench.errors import UnusableInputError
from hilbench.runs.commissioning import GENTLE, HOLD_S, OF_LIMIT, SLOW, STEEP, Reach, highest_of_steps
from hilbench.runs.config import ExperimentConfig
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.web_line_quantities import tension_set_point

#: The second tension over the first, and the least that distinguishes them.
_SECOND, _LEAST_SECOND = 1.25, 1.1
#: A turn of each roller at the slow level has to fit into its hold: below that speed nothing is known of a turn.
_LEAST_TURNS: Final = 0.25


def reach_of_line(config: ExperimentConfig, place: Path) -> Reach:
    """Range of the commissioning of a line of driven rollers; see `commissioning_plan`."""
    model = config.web_line
    if model.stations is not None:
        raise UnusableInputError(
            place, "a line with 'stations', expected one of driven rollers alone: others can't be commissioned yet"
        )
    if model.web is None or model.drives is None:
        raise UnusableInputError(place, "a machine without web or drives, expected a web line to commission")
    limits = operator_ranges(config)
    usual_m_s = highest_of_steps(config, LINE_SPEED) or config.twin.model_errors.at_speed_m_s
    top_m_s = min(usual_m_s, OF_LIMIT * limits[LINE_SPEED][1])
    for axis in range(1, model.axis_count + 1):
        turn_m = 6.283 * model.radius_m(axis)
        least_m_s = _LEAST_TURNS * turn_m / (SLOW * HOLD_S)
        if top_m_s < least_m_s:
            raise UnusableInputError(
                place,
                f"speeds up to {top_m_s:.2g} m/s by its steps and safety.limits.speed_m_s, expected {least_m_s:.2g} "
                f"m/s or more, for turns of roller {axis}",
            )
    fastest_m_s2 = min(config.fastest_m_s2(axis) for axis in range(1, model.axis_count + 1))
    set_points = [_set_points(config, span, limits, place) for span in config.tension_controls]
    return Reach(LINE_SPEED, "m/s", top_m_s, STEEP * fastest_m_s2, GENTLE * fastest_m_s2, set_points)


def _set_points(
    config: ExperimentConfig, span: int, limits: dict[str, tuple[float, float]], place: Path
) -> tuple[str, float, float, str]:
    path = tension_set_point(config.shape.numbered(span))
    first_N = config.tension_controls[span].set_point_N
    second_N = round(min(_SECOND * first_N, OF_LIMIT * limits[path][1]), 3)
    if second_N < _LEAST_SECOND * first_N:
        raise UnusableInputError(
            place,
            f"safety.limits.tension_N lets {path} go from {first_N:g} to {second_N:g} N, expected a second tension of "
            f"{_LEAST_SECOND * first_N:g} N or more",
        )
    return path, first_N, second_N, "N"
