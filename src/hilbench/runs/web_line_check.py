"""What the steps of an experiment ask of a web line: where its loops will work, and what they will run into."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from hilbench.bench.tasks.tension_loop import OperatingPoint
from hilbench.bench.web_line_check import SAME_MODULUS
from hilbench.plant.parameters import per_item
from hilbench.runs.config import ExperimentConfig, LoadedConfig
from hilbench.runs.prospect import Move, State, start_of
from hilbench.strict_yaml import Location
from hilbench.topology.safety import Limit

#: A difference that makes no other operating point.
_SAME_SPEED_M_S = 0.05
#: So many operating points are looked at; of more those with extreme values.
_MOST_POINTS = 24


def operating_points(config: ExperimentConfig, asked: list[Move]) -> dict[OperatingPoint, Location]:
    """Where the loop will be, each with the step that brings it there; behind a step of E with the old one believed."""
    start = start_of(config)
    model_Pa = config.web_line.required_web.youngs_modulus_Pa
    points: dict[OperatingPoint, Location] = {}

    def add(state: State, believed_Pa: float) -> None:
        if state.youngs_modulus_Pa <= 0.0 or believed_Pa <= 0.0:
            return  # values are checked where they enter
        factor = state.length_factor
        point = OperatingPoint(state.youngs_modulus_Pa, abs(state.line_speed_m_s), factor, believed_Pa)
        if not any(_alike(point, known) for known in points):
            points[point] = state.place

    add(start, model_Pa)
    add(start, start.youngs_modulus_Pa)
    for move in asked:
        if move.duration_s == 0.0 and move.before.youngs_modulus_Pa != move.after.youngs_modulus_Pa:
            add(move.after, move.before.youngs_modulus_Pa)
        add(move.after, move.after.youngs_modulus_Pa)
    return points if len(points) <= _MOST_POINTS else _extremes(points)


def stiffness_of(point: OperatingPoint) -> float:
    """Of the web, to compare points by."""
    return point.youngs_modulus_Pa / point.length_factor


def _alike(one: OperatingPoint, other: OperatingPoint) -> bool:
    return (
        abs(one.line_speed_m_s - other.line_speed_m_s) <= _SAME_SPEED_M_S
        and one.length_factor == other.length_factor
        and abs(one.youngs_modulus_Pa / other.youngs_modulus_Pa - 1.0) <= SAME_MODULUS
        and abs(one.estimate_Pa / other.estimate_Pa - 1.0) <= SAME_MODULUS
    )


def _extremes(points: dict[OperatingPoint, Location]) -> dict[OperatingPoint, Location]:
    """The softest and the stiffest, the slowest and the fastest, those that are believed wrongly the most."""

    def mistake(point: OperatingPoint) -> float:
        return point.youngs_modulus_Pa / point.estimate_Pa

    kept: dict[OperatingPoint, Location] = {}
    for order in (
        stiffness_of,
        lambda point: point.line_speed_m_s,
        mistake,
    ):
        ordered = sorted(points, key=order)
        kept |= {point: points[point] for point in (*ordered[: _MOST_POINTS // 6], *ordered[-_MOST_POINTS // 6 :])}
    return kept


def step_warnings(loaded: LoadedConfig, asked: list[Move]) -> Iterator[str]:
    """What the steps will run into."""
    limits = loaded.config.safety.limits
    model_Pa = loaded.config.web_line.required_web.youngs_modulus_Pa
    for move in asked:
        before, after = move.before, move.after
        at = loaded.document.place(after.place)
        modulus_Pa = after.youngs_modulus_Pa
        for path, set_point_N in after.set_points_N.items():
            if set_point_N != before.set_points_N.get(path):
                yield from beyond(at, "set-point of the tension", set_point_N, limits.tension_N, "N")
        if after.line_speed_m_s != before.line_speed_m_s:
            yield from beyond(at, "line speed", abs(after.line_speed_m_s), limits.speed_m_s, "m/s")
            yield from _too_fast(loaded.config, at, move)
        if modulus_Pa > 0.0 and before.youngs_modulus_Pa > 0.0 and modulus_Pa != before.youngs_modulus_Pa:
            ratio = max(modulus_Pa / model_Pa, model_Pa / modulus_Pa)
            yield from beyond(at, "E over the model's (or its inverse)", ratio, limits.estimate_ratio, "")
            if move.duration_s == 0.0:
                tension_N = max(after.set_points_N.values()) * modulus_Pa / before.youngs_modulus_Pa
                yield from beyond(at, "tension right behind this step of E", tension_N, limits.tension_N, "N")


def beyond(at: str, what: str, value: float, limit: Limit, unit: str) -> Iterator[str]:
    """A value that will end the run."""
    if limit.trip is not None and value > limit.trip:
        told, level = f"{value:.4g} {unit}".strip(), f"{limit.trip:g} {unit}".strip()
        yield f"{at}: {what} {told} is beyond the trip level {level}: the run will end there in the safe state"


def _too_fast(config: ExperimentConfig, at: str, move: Move) -> Iterator[str]:
    """An acceleration, or a jump, that takes more torque than a drive has."""
    drives, model = config.web_line.drives, config.web_line
    assert drives is not None, "a bench's model has drives"
    way_m_s = abs(move.after.line_speed_m_s - move.before.line_speed_m_s)
    longest_s, named, needed_Nm, limit_Nm = 0.0, 0, 0.0, inf
    for axis in range(1, model.axis_count + 1):
        rad_per_m, most_Nm = model.motor_rad_per_m(axis), per_item(drives.torque_limit_Nm, axis)
        if move.duration_s > 0.0:
            asks_Nm = model.mass_kg(axis) * way_m_s / move.duration_s / rad_per_m
        else:
            asks_Nm = per_item(drives.velocity_kp_Nm_s_per_rad, axis) * way_m_s * rad_per_m
        at_least_s = model.mass_kg(axis) * way_m_s / (most_Nm * rad_per_m)
        if asks_Nm > most_Nm and at_least_s > longest_s:
            longest_s, named, needed_Nm, limit_Nm = at_least_s, axis, asks_Nm, most_Nm
    if named:
        how = f"within {move.duration_s:g} s" if move.duration_s > 0.0 else "at once"
        yield (
            f"{at}: line speed from {move.before.line_speed_m_s:g} to {move.after.line_speed_m_s:g} m/s {how} asks for "
            f"{needed_Nm:.3g} N·m of axis {named}, which has {limit_Nm:g} N·m: it is at its limit and there no sooner "
            f"than {longest_s:.2g} s later, expected a ramp of more than that"
        )
