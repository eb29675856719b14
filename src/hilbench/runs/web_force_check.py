"""Check of an experiment's steps on the cylinders of carriages whose force is sent ahead."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Final

from hilbench.bench.tasks.web_winding_control import CarriageForce, eased
from hilbench.plant.web_line.stations import LineCarriage
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.set_point_schedule import Move
from hilbench.topology.web_line_positions import FEED, FORCE_SET_POINT, position_path

#: Parts of a ramp at which the force is looked at.
_PARTS: Final = 40
#: Speed and acceleration of the web before a carriage, then of that behind it.
Ends = tuple[float, float, float, float]


def beyond_cylinders(config: ExperimentConfig, at: str, move: Move) -> Iterator[str]:
    """Forces that a move of the line asks for, and cylinders do not have: they push, and up to a limit."""
    for carriage in config.web_line.carriages:
        name = carriage.station.name
        control = config.position_controls.get(name)
        if control is None or control.force is None:
            continue
        moved = list(_motions(config, name, move))
        if not moved:
            continue
        limit_N = inf if control.force.limit_N is None else control.force.limit_N
        asked_N = [_force_N(config, carriage, move, ends) for ends in moved]
        least_N, most_N = min(asked_N), max(asked_N)
        for force_N, has, it in (
            (least_N, least_N >= 0.0, "never pulls"),
            (most_N, most_N <= limit_N, f"has {limit_N:g} N"),
        ):
            if not has:
                yield (
                    f"{at}: asks for {force_N:.4g} N of the cylinder of '{name}', which {it}: its tensions are off by "
                    f"what is missing, expected a slower change"
                )


def _motions(config: ExperimentConfig, name: str, move: Move) -> Iterator[Ends]:
    """Web motions at the ends of a carriage; nothing where the move is none of its speeds."""
    before, after, path = move.before, move.after, position_path(name, FEED)
    speed_m_s, feed = after.line_speed_m_s, after.values.get(path, 1.0)
    fed, went_m_s = before.values.get(path, 1.0), before.line_speed_m_s
    parts = [part / _PARTS for part in range(_PARTS + 1)]
    if feed != fed:
        ramp_s = config.position_controls[name].feed_ramp_s
        for share, rate in map(eased, parts):
            turned_m_s = speed_m_s * (fed + share * (feed - fed))
            yield turned_m_s, speed_m_s * rate * (feed - fed) / ramp_s, speed_m_s, 0.0
    if speed_m_s != went_m_s and move.duration_s > 0.0:
        rate_m_s2 = (speed_m_s - went_m_s) / move.duration_s
        for part in parts:
            now_m_s = went_m_s + part * (speed_m_s - went_m_s)
            yield feed * now_m_s, feed * rate_m_s2, now_m_s, rate_m_s2


def _force_N(config: ExperimentConfig, carriage: LineCarriage, move: Move, ends: Ends) -> float:
    station, control = carriage.station, config.position_controls[carriage.station.name]
    assert control.force is not None, "asked before"
    path = position_path(station.name, FORCE_SET_POINT)
    tension_N = move.after.values.get(path, control.force.tension_N(station))
    before_m_s, before_m_s2, behind_m_s, behind_m_s2 = ends
    ahead = CarriageForce(config.web_line, carriage, behind_takes=control.force.behind_takes)
    return ahead.force_N(tension_N, before_m_s, behind_m_s, before_m_s2, behind_m_s2, station.position_m)
