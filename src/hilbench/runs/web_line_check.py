"""Check of an experiment's steps on a web line: operating points of its loops, and limits they will reach."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import acos, acosh, copysign, exp, expm1, inf, isfinite, nan, prod, sqrt
from typing import Final

import numpy as np

from hilbench.bench.check import CheckedBench
from hilbench.bench.tasks.tension_loop import Moduli, OperatingPoint, TensionLoop
from hilbench.bench.tasks.web_winding_control import CarriageForce, eased
from hilbench.bench.web_line_check import alike, check_stability, stiffness_reserves
from hilbench.cia402.units import RPM
from hilbench.plant.effects import find_effect
from hilbench.plant.matrix_exponential import matrix_exponential
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.stations import LineCarriage
from hilbench.runs.check import CheckedExperiment, Worst
from hilbench.runs.config import ExperimentConfig, LoadedConfig
from hilbench.runs.drive_check import beyond, max_motor_speed_rpm, torque_limit_Nm
from hilbench.runs.set_point_schedule import Move, State, start_of
from hilbench.strict_yaml import Location
from hilbench.topology.parts import Role
from hilbench.topology.web_line_quantities import (
    FEED,
    FORCE_SET_POINT,
    YOUNGS_MODULUS,
    modulus_of_span,
    position_path,
    tension_set_point,
)

#: A difference that makes no other operating point.
_SAME_SPEED_M_S = 0.05
#: So many operating points are looked at; of more those with extreme values.
_MOST_POINTS = 24
#: Instants of a cycle at which torque is looked at.
_PARTS = 16
#: Margins below which a loop is noted.
_LEAST_GAIN, _LEAST_PHASE_DEG = 2.0, 30.0


def check_steps(
    loaded: LoadedConfig, bench: CheckedBench, asked: list[Move], *, with_margins: bool
) -> CheckedExperiment:
    """Web, drives, bus and twin are stable wherever the steps bring them."""
    config, document = loaded.config, loaded.document
    places = operating_points(config, asked)
    for point, place in places.items():
        check_stability(config, document, point, place if len(place) > 1 else ("machine", "web"))
    reserves = stiffness_reserves(config, max(places, key=stiffness_of))
    reserve = min(reserves.values(), default=inf)
    stations = config.shape.has_stations
    worst = _worst(config, list(places)) if with_margins and not stations else None
    warnings = [*_too_far_apart_at_first(loaded), *step_warnings(loaded, asked)]
    notes = list(bench.notes)
    if worst is not None and (worst.margins.gain < _LEAST_GAIN or worst.margins.phase_deg < _LEAST_PHASE_DEG):
        warnings.append(
            f"the tension loop rings: {worst}, expected at least {_LEAST_GAIN:g} and {_LEAST_PHASE_DEG:g}°, by a "
            f"smaller bandwidth_rad_per_s of the controllers, more swing_damping_ratio or a shorter cycle"
        )
    if stations:
        notes.append(
            "how stable the tension loops are is not looked at: idlers, dancers and accumulators swing beside the "
            "driven rollers"
        )
    if reserve < 1.0:
        notes.append(
            "the load motor emulates so stiff a web only with the active damping of axis 1 (swing_damping_ratio)"
        )
    named = {config.load_motor_of(axis): value for axis, value in reserves.items()}
    return CheckedExperiment(bench, reserve, worst, warnings, notes, stiffness_reserves=named)


def _worst(config: ExperimentConfig, points: list[OperatingPoint]) -> Worst:
    found = [Worst(point, TensionLoop(config, point).margins) for point in points]
    return min(found, key=lambda one: min(one.margins.gain / _LEAST_GAIN, one.margins.phase_deg / _LEAST_PHASE_DEG))


def operating_points(config: ExperimentConfig, asked: list[Move]) -> dict[OperatingPoint, Location]:
    """Operating points of the loop, each with the step that leads there; after a step of E with the old one
    believed."""
    start, spans = start_of(config), range(1, config.shape.spans + 1)
    points: dict[OperatingPoint, Location] = {}

    def add(state: State, believed_Pa: Moduli) -> None:
        moduli_Pa = _moduli(state, spans)
        if min(*moduli_Pa, *believed_Pa) <= 0.0:
            return  # values are checked where they enter
        factors = tuple(_length_factor(state, span) for span in spans)
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


def _modulus_Pa(state: State, span: int) -> float:
    """E of a span (from 1) of the emulated web, with its effects."""
    modulus_Pa = state.values.get(modulus_of_span(span), state.values[YOUNGS_MODULUS])
    for effect, parameters in _effects_in(state, span):
        modulus_Pa *= _elasticity_factor(effect, parameters, state.time_s)
    return modulus_Pa


def _length_factor(state: State, span: int) -> float:
    """Length factor of a span (from 1) of the emulated web."""
    effects = _effects_in(state, span)
    return prod(1.0 + p["relative_change"] for effect, p in effects if effect == "span_length_error")


def _effects_in(state: State, span: int) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Effects of a span, and of all spans or of the whole line."""
    for entry in state.effects:
        if entry.span in (None, span):
            yield entry.effect, find_effect(entry.effect).filled(entry.parameters)
    changed = state.load_effects
    for (effect, axis, at), parameters in changed.items():
        if at == span or (at is None and (effect, axis, span) not in changed):
            yield effect, find_effect(effect).filled(parameters)


def _elasticity_factor(effect: str, parameters: Mapping[str, float], t_s: float) -> float:
    """Factor of an effect on E, as `hilbench.plant.web_line.laws` has it; 1 for one that is none of the elasticity."""
    change = parameters.get("relative_change", 0.0)
    if effect == "elasticity_shift":
        return 1.0 + change
    if effect == "elasticity_step":
        return 1.0 + change if t_s >= parameters["time_s"] else 1.0
    if effect == "elasticity_ramp":
        return 1.0 + change * min(max((t_s - parameters["time_s"]) / parameters["duration_s"], 0.0), 1.0)
    if effect == "elasticity_drift":
        return 1.0 + parameters["rate_per_s"] * t_s
    return 1.0


def _moduli(state: State, spans: Iterable[int]) -> Moduli:
    return tuple(_modulus_Pa(state, span) for span in spans)


def stiffness_of(point: OperatingPoint) -> float:
    """Stiffness of the stiffest span, to compare points by."""
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
    for order in (stiffness_of, lambda point: point.line_speed_m_s, mistake):
        ordered = sorted(points, key=order)
        kept |= {point: points[point] for point in (*ordered[: _MOST_POINTS // 6], *ordered[-_MOST_POINTS // 6 :])}
    return kept


def step_warnings(loaded: LoadedConfig, asked: list[Move]) -> Iterator[str]:
    """Warnings on the limits that the steps will reach."""
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
        yield from beyond_cylinders(loaded.config, at, move)
        yield from _of_a_change_of_E(loaded.config, at, move)


def _too_far_apart_at_first(loaded: LoadedConfig) -> Iterator[str]:
    """Outer tensions so far apart that the last roller turns too fast when it is enabled.

    All spans begin with the upstream tension, so that the web pulls at the last roller alone: against its velocity loop
    and the last span, whose force the load motor emulates one and a half cycles late.
    """
    config, model = loaded.config, loaded.config.web_line
    axis, around = model.axis_count, model.boundary
    if config.shape.has_stations or axis not in config.loaded_axes or not model.carries_web_load(axis):
        return
    assert model.drives is not None, "a bench's model has drives"
    rad_per_m, span = model.motor_rad_per_m(axis), model.span_count
    web_N_per_m = model.stiffness_N(span) / model.span_length_m(span)
    held_N_per_m = web_N_per_m + per_item(model.drives.velocity_ki_Nm_per_rad, axis) * rad_per_m**2
    damping_kg_s = model.mass_kg(axis) * model.velocity_loop_per_s(axis) - 1.5 * config.cycle_time_s * web_N_per_m
    natural_kg_s = sqrt(held_N_per_m * model.mass_kg(axis))
    ratio = max(damping_kg_s, 0.0) / (2.0 * natural_kg_s)
    root = sqrt(abs(1.0 - ratio**2))
    decay = ratio * (acos(ratio) if ratio < 1.0 else acosh(ratio)) / root if root else 1.0
    pull_N = around.downstream_tension_N - around.upstream_tension_N
    peak_rpm = abs(pull_N) / natural_kg_s * exp(-decay) * rad_per_m / RPM
    shaft = [part for part in config.parts if part.axis == axis and part.role is not Role.VIRTUAL_AXIS]
    slowest_rpm, part = min(((max_motor_speed_rpm(part), part) for part in shaft), key=lambda found: found[0])
    if peak_rpm > slowest_rpm:
        yield (
            f"{loaded.document.place(('machine', 'boundary', 'downstream_tension_N'))}: {pull_N:+.4g} N behind axis "
            f"{axis} against the upstream tension turns it at up to {peak_rpm:.0f} rpm when it is enabled, and "
            f"{part.name} goes up to {slowest_rpm:.0f} rpm (6080h): it may report overspeed, expected tensions that "
            f"are at most {abs(pull_N) * slowest_rpm / peak_rpm:.3g} N apart"
        )


def _of_a_change_of_E(config: ExperimentConfig, at: str, move: Move) -> Iterator[str]:
    """Warnings on the span whose E is then off the most, or jumps the most."""
    limits, model = config.safety.limits, config.web_line
    changed = []
    for span in range(1, model.span_count + 1):
        before_Pa, after_Pa = _modulus_Pa(move.before, span), _modulus_Pa(move.after, span)
        if before_Pa > 0.0 and after_Pa > 0.0 and before_Pa != after_Pa:
            model_Pa = model.youngs_modulus_Pa(span)
            changed.append((max(after_Pa / model_Pa, model_Pa / after_Pa), after_Pa / before_Pa))
    if changed:
        ratio = max(ratio for ratio, _ in changed)
        yield from beyond(at, "E over the model's (or its inverse)", ratio, limits.estimate_ratio, "")
        if move.duration_s == 0.0:
            tension_N = max(move.after.set_points_N.values()) * max(jump for _, jump in changed)
            yield from beyond(at, "tension right behind this step of E", tension_N, limits.tension_N, "N")


def _too_fast(config: ExperimentConfig, at: str, move: Move) -> Iterator[str]:
    """An acceleration, or a jump, that takes more torque than a drive has."""
    drives, model = config.web_line.drives, config.web_line
    assert drives is not None, "a bench's model has drives"
    gained_m_s = move.after.line_speed_m_s - move.before.line_speed_m_s
    longest_s, named, needed_Nm, limit_Nm = 0.0, "", 0.0, inf
    for part in (*config.parts_of(Role.AXIS), *config.parts_of(Role.VIRTUAL_AXIS)):
        axis = part.axis or 1
        rad_per_m, most_Nm, mass_kg = model.motor_rad_per_m(axis), torque_limit_Nm(config, part), model.mass_kg(axis)
        pull_N = _pull_N(config, axis, move.after)
        if move.duration_s > 0.0:
            lag_s = per_item(drives.current_loop_time_constant_s, axis)
            peak = _peak_of_torque(model.velocity_loop_per_s(axis), lag_s, config.cycle_time_s)
            asks_Nm = abs(mass_kg * gained_m_s * peak / move.duration_s + pull_N) / rad_per_m
        else:
            kp = per_item(drives.velocity_kp_Nm_s_per_rad, axis)
            peak, asks_Nm = 1.0, kp * abs(gained_m_s) * rad_per_m
        left_N = most_Nm * rad_per_m - pull_N * copysign(1.0, gained_m_s)
        at_least_s = mass_kg * abs(gained_m_s) * peak / left_N if left_N > 0.0 else inf
        if asks_Nm > most_Nm and at_least_s > longest_s:
            named = f"virtual axis {axis}" if part.is_virtual else f"axis {axis}"
            longest_s, needed_Nm, limit_Nm = at_least_s, asks_Nm, most_Nm
    if named:
        how = f"within {move.duration_s:g} s" if move.duration_s > 0.0 else "at once"
        yield (
            f"{at}: line speed from {move.before.line_speed_m_s:g} to {move.after.line_speed_m_s:g} m/s {how} asks for "
            f"{needed_Nm:.3g} N·m of {named}, which has {limit_Nm:g} N·m: it is at its limit and there no sooner "
            f"than {longest_s:.2g} s later, expected a ramp of more than that"
        )


def _peak_of_torque(loop_per_s: float, lag_s: float, cycle_s: float) -> float:
    """Largest torque over the mean in a ramp: set points go in steps, behind each of which the velocity loop (bandwidth
    `loop_per_s`) asks for more, as fast as the current loop (`lag_s`) follows."""
    settled = loop_per_s * cycle_s
    if settled == 0.0 or lag_s == 0.0:
        return settled / -expm1(-settled) if settled else 1.0
    # Velocity error and acceleration between two set points, periodic.
    a_while = matrix_exponential(np.array([[0.0, -1.0], [loop_per_s / lag_s, -1.0 / lag_s]]) * cycle_s / _PARTS)
    state = np.linalg.solve(np.eye(2) - np.linalg.matrix_power(a_while, _PARTS), [cycle_s, 0.0])
    peak = 0.0
    for _ in range(_PARTS):
        state = a_while @ state
        peak = max(peak, float(state[1]))
    return peak


def _pull_N(config: ExperimentConfig, axis: int, state: State) -> float:
    """Excess of the upstream over the downstream web force at an axis, where the tensions are set-points; else 0."""
    model, around = config.web_line, config.web_line.boundary
    if config.shape.has_stations or not model.carries_web_load(axis):
        return 0.0
    paths = (tension_set_point(config.shape.numbered(span)) for span in range(1, model.span_count + 1))
    of_spans_N = (state.values.get(path, nan) for path in paths)
    tensions_N = [around.upstream_tension_N, *of_spans_N, around.downstream_tension_N]
    pull_N = tensions_N[axis - 1] - tensions_N[axis]
    return pull_N if isfinite(pull_N) else 0.0


#: Parts of a ramp at which the force is looked at.
_FORCE_PARTS: Final = 40
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
    parts = [part / _FORCE_PARTS for part in range(_FORCE_PARTS + 1)]
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
