"""What the steps of an experiment ask of a web line: where its loops will work, and what they will run into."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import inf

from hilbench.bench.tasks.tension_loop import Moduli, OperatingPoint
from hilbench.bench.web_line_check import alike
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
    start, spans = start_of(config), range(1, config.shape.spans + 1)
    points: dict[OperatingPoint, Location] = {}

    def add(state: State, believed_Pa: Moduli) -> None:
        moduli_Pa = _moduli(state, spans)
        if min(*moduli_Pa, *believed_Pa) <= 0.0:
            return  # values are checked where they enter
        factors = tuple(state.length_factor(span) for span in spans)
        point = OperatingPoint(moduli_Pa, abs(state.line_speed_m_s), factors, believed_Pa)
        if not any(_alike(point, known) for known in points):
            points[point] = state.place

    add(start, tuple(config.web_line.youngs_modulus_Pa(span) for span in spans))
    add(start, _moduli(start, spans))
    for move in asked:
        before, after = _moduli(move.before, spans), _moduli(move.after, spans)
        if move.duration_s == 0.0 and before != after:
            add(move.after, before)
        add(move.after, after)
    return points if len(points) <= _MOST_POINTS else _extremes(points)


def _moduli(state: State, spans: Iterable[int]) -> Moduli:
    return tuple(state.youngs_modulus_Pa(span) for span in spans)


def stiffness_of(point: OperatingPoint) -> float:
    """Of the stiffest span, to compare points by."""
    return max(modulus / factor for modulus, factor in zip(point.moduli_Pa, point.length_factors, strict=True))


def _alike(one: OperatingPoint, other: OperatingPoint) -> bool:
    return (
        abs(one.line_speed_m_s - other.line_speed_m_s) <= _SAME_SPEED_M_S
        and one.length_factors == other.length_factors
        and alike(one.moduli_Pa, other.moduli_Pa)
        and alike(one.estimates_Pa, other.estimates_Pa)
    )


def _extremes(points: dict[OperatingPoint, Location]) -> dict[OperatingPoint, Location]:
    """The softest and the stiffest, the slowest and the fastest, those that are believed wrongly the most."""

    def mistake(point: OperatingPoint) -> float:
        return max(true / believed for true, believed in zip(point.moduli_Pa, point.estimates_Pa, strict=True))

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
    for move in asked:
        before, after = move.before, move.after
        at = loaded.document.place(after.place)
        for path, set_point_N in after.set_points_N.items():
            if set_point_N != before.set_points_N.get(path):
                yield from beyond(at, "set-point of the tension", set_point_N, limits.tension_N, "N")
        if after.line_speed_m_s != before.line_speed_m_s:
            yield from beyond(at, "line speed", abs(after.line_speed_m_s), limits.speed_m_s, "m/s")
            yield from _too_fast(loaded.config, at, move)
        yield from _of_a_change_of_E(loaded.config, at, move)


def _of_a_change_of_E(config: ExperimentConfig, at: str, move: Move) -> Iterator[str]:
    """What the span whose E is then off the most, or jumps the most, runs into."""
    limits, model = config.safety.limits, config.web_line
    changed = []
    for span in range(1, model.span_count + 1):
        before_Pa, after_Pa = move.before.youngs_modulus_Pa(span), move.after.youngs_modulus_Pa(span)
        if before_Pa > 0.0 and after_Pa > 0.0 and before_Pa != after_Pa:
            model_Pa = model.youngs_modulus_Pa(span)
            changed.append((max(after_Pa / model_Pa, model_Pa / after_Pa), after_Pa / before_Pa))
    if changed:
        ratio = max(ratio for ratio, _ in changed)
        yield from beyond(at, "E over the model's (or its inverse)", ratio, limits.estimate_ratio, "")
        if move.duration_s == 0.0:
            tension_N = max(move.after.set_points_N.values()) * max(jump for _, jump in changed)
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
