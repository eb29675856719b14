"""What must hold of a config and its experiment before anything starts, and what an operator should know of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite

from hilbench.bench.check import CheckedBench, check_bench, check_imitated_inertia, imitable_inertias_kg_m2
from hilbench.bench.tasks.tension_loop import Margins, OperatingPoint, TensionLoop
from hilbench.bench.web_line_check import SAME_MODULUS, check_stability, operating_point_text, stiffness_reserve
from hilbench.errors import UnusableInputError
from hilbench.plant.effects import MachineKind
from hilbench.plant.parameters import per_item
from hilbench.runs.config import ExperimentConfig, LoadedConfig
from hilbench.runs.metrics import OF_RUNS, metrics_of
from hilbench.runs.prospect import Move, State, moves, start_of
from hilbench.strict_yaml import Location
from hilbench.suggest import did_you_mean
from hilbench.topology.quantities import SHAFT_COULOMB_FRICTION, SHAFT_INERTIA, SPEED
from hilbench.topology.safety import Limit

#: Margins below which a loop is noted.
_LEAST_GAIN, _LEAST_PHASE_DEG = 2.0, 30.0
#: A difference that makes no other operating point.
_SAME_SPEED_M_S = 0.05
#: So many operating points are looked at; of more those with extreme values.
_MOST_POINTS = 24


@dataclass(frozen=True)
class Worst:
    """The operating point with the least margins."""

    point: OperatingPoint
    margins: Margins

    def __str__(self) -> str:
        gain = f"{self.margins.gain:.2f}" if isfinite(self.margins.gain) else "any"
        at = operating_point_text(self.point)
        return f"gain margin {gain}, phase margin {self.margins.phase_deg:.0f}° where they are least: {at}"


@dataclass(frozen=True)
class CheckedExperiment:
    """What the check found."""

    bench: CheckedBench
    #: Stiffest web that the load motor could imitate by itself, over the stiffest asked for; None: there is no web.
    stiffness_reserve: float | None
    worst: Worst | None  #: None where margins were not asked for
    warnings: list[str]  #: what will happen that hardly anybody means to happen
    notes: list[str]  #: what can be run, and will not be good; what can't be known
    inertia_reserve: float | None = None  #: largest inertia that can be imitated, over the largest asked for


def check_experiment(loaded: LoadedConfig, *, with_margins: bool = False) -> CheckedExperiment:
    """Check a config and what its steps ask for, as far as can be without a bus.

    Raises UnusableInputError as `check_bench`, for a Python file that can't be used, and with the step's place where
    the loop through web, drives, bus and twin would be unstable.
    """
    config, document = loaded.config, loaded.document
    bench = check_bench(config, document)
    for step in config.steps:
        step.prepare()
    asked = list(moves(config))
    _check_paths(loaded, asked)
    _check_criteria(loaded)
    _check_methods(loaded)
    if config.machine_kind is MachineKind.SERVO_AXIS:
        found = _check_shaft(loaded, bench, asked)
    else:
        found = _check_web(loaded, bench, asked, with_margins=with_margins)
    for number, step in enumerate(config.steps):
        if step.python is not None:
            found.notes.append(
                f"{document.place(('steps', number))}: what '{step.python.function}' of {step.python.file.name} asks "
                f"for can't be known before it runs: neither stability nor limits are checked for it"
            )
    return found


def _check_paths(loaded: LoadedConfig, asked: list[Move]) -> None:
    """Every quantity that a step changes is one of this machine."""
    for move in asked:
        for path in move.after.values.keys() - move.before.values.keys():
            problem = loaded.config.path_problem(path)
            if problem:
                raise UnusableInputError(loaded.document.place(move.after.place), f"expected {problem}")


def _check_methods(loaded: LoadedConfig) -> None:
    """The twin of a shaft has one method."""
    kind = loaded.config.machine_kind
    for number, step in enumerate(loaded.config.steps):
        if step.synchronizer is not None and kind is MachineKind.SERVO_AXIS:
            place = loaded.document.place(("steps", number, "synchronizer"))
            raise UnusableInputError(
                place, f"a change of the twin's method, expected none: the twin of a {kind} has one method"
            )


def _check_criteria(loaded: LoadedConfig) -> None:
    """Every metric that a criterion bounds is one that a run of this machine may have."""
    config = loaded.config
    known = {**metrics_of(config.machine.kind, config.shape).metrics, **OF_RUNS}
    for number, criterion in enumerate(config.criteria):
        if criterion.metric not in known:
            meant = did_you_mean(criterion.metric, known)
            raise UnusableInputError(
                loaded.document.place(("criteria", number, "metric")),
                f"metric '{criterion.metric}' is none of this machine, expected one of {', '.join(known)}{meant}",
            )


def _check_shaft(loaded: LoadedConfig, bench: CheckedBench, asked: list[Move]) -> CheckedExperiment:
    """The load motor can imitate every inertia that is asked for; speeds and torques are within limits."""
    config, document = loaded.config, loaded.document
    limits, inertias = config.safety.limits, [start_of(config).values[SHAFT_INERTIA]]
    warnings: list[str] = []
    most_Nm = per_item(config.drive_parameters.torque_limit_Nm, 1)
    for move in asked:
        before, after, at = move.before.values, move.after.values, document.place(move.after.place)
        inertia = after[SHAFT_INERTIA]
        if inertia != before[SHAFT_INERTIA]:
            check_imitated_inertia(config, document, inertia, move.after.place)
            inertias.append(inertia)
        way_rad_s = abs(after[SPEED] - before[SPEED])
        if way_rad_s:
            warnings += _beyond(at, "speed", abs(after[SPEED]), limits.speed_rad_s, "rad/s")
        if move.duration_s > 0.0:
            needed_Nm = inertia * way_rad_s / move.duration_s + after[SHAFT_COULOMB_FRICTION]
            if way_rad_s and needed_Nm > most_Nm:
                warnings.append(
                    f"{at}: {way_rad_s:g} rad/s within {move.duration_s:g} s ask for {needed_Nm:.3g} N·m of axis 1, "
                    f"which has {most_Nm:g} N·m, expected a longer ramp"
                )
    reserve = imitable_inertias_kg_m2(config)[1] / max(inertias)
    return CheckedExperiment(bench, None, None, warnings, list(bench.notes), inertia_reserve=reserve)


def _check_web(
    loaded: LoadedConfig, bench: CheckedBench, asked: list[Move], *, with_margins: bool
) -> CheckedExperiment:
    """Web, drives, bus and twin are stable wherever the steps bring them."""
    config, document = loaded.config, loaded.document
    places = _operating_points(config, asked)
    for point, place in places.items():
        check_stability(config, document, point, place if len(place) > 1 else ("machine", "web"))
    reserve = stiffness_reserve(config, max(places, key=_stiffness))
    worst = _worst(config, list(places)) if with_margins else None
    warnings = list(_warnings(loaded, asked))
    notes = list(bench.notes)
    if worst is not None and (worst.margins.gain < _LEAST_GAIN or worst.margins.phase_deg < _LEAST_PHASE_DEG):
        warnings.append(
            f"the tension loop rings: {worst}, expected at least {_LEAST_GAIN:g} and {_LEAST_PHASE_DEG:g}°, by a "
            f"smaller bandwidth_rad_per_s of the controllers, more swing_damping_ratio or a shorter cycle"
        )
    if reserve < 1.0:
        notes.append(
            "the load motor imitates so stiff a web only with the active damping of axis 1 (swing_damping_ratio)"
        )
    return CheckedExperiment(bench, reserve, worst, warnings, notes)


# -- stability ---------------------------------------------------------------------------------------------------------


def _operating_points(config: ExperimentConfig, asked: list[Move]) -> dict[OperatingPoint, Location]:
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


def _stiffness(point: OperatingPoint) -> float:
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
        _stiffness,
        lambda point: point.line_speed_m_s,
        mistake,
    ):
        ordered = sorted(points, key=order)
        kept |= {point: points[point] for point in (*ordered[: _MOST_POINTS // 6], *ordered[-_MOST_POINTS // 6 :])}
    return kept


def _worst(config: ExperimentConfig, points: list[OperatingPoint]) -> Worst:
    found = [Worst(point, TensionLoop(config, point).margins) for point in points]
    return min(found, key=lambda one: min(one.margins.gain / _LEAST_GAIN, one.margins.phase_deg / _LEAST_PHASE_DEG))


# -- limits ------------------------------------------------------------------------------------------------------------


def _warnings(loaded: LoadedConfig, asked: list[Move]) -> Iterator[str]:
    """What the steps will run into."""
    limits = loaded.config.safety.limits
    model_Pa = loaded.config.web_line.required_web.youngs_modulus_Pa
    for move in asked:
        before, after = move.before, move.after
        at = loaded.document.place(after.place)
        modulus_Pa = after.youngs_modulus_Pa
        for path, set_point_N in after.set_points_N.items():
            if set_point_N != before.set_points_N.get(path):
                yield from _beyond(at, "set-point of the tension", set_point_N, limits.tension_N, "N")
        if after.line_speed_m_s != before.line_speed_m_s:
            yield from _beyond(at, "line speed", abs(after.line_speed_m_s), limits.speed_m_s, "m/s")
            yield from _too_fast(loaded.config, at, move)
        if modulus_Pa > 0.0 and before.youngs_modulus_Pa > 0.0 and modulus_Pa != before.youngs_modulus_Pa:
            ratio = max(modulus_Pa / model_Pa, model_Pa / modulus_Pa)
            yield from _beyond(at, "E over the model's (or its inverse)", ratio, limits.estimate_ratio, "")
            if move.duration_s == 0.0:
                tension_N = max(after.set_points_N.values()) * modulus_Pa / before.youngs_modulus_Pa
                yield from _beyond(at, "tension right behind this step of E", tension_N, limits.tension_N, "N")


def _beyond(at: str, what: str, value: float, limit: Limit, unit: str) -> Iterator[str]:
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
